"""The tracer against Mitsuba's own render, the furnace, and the cameras' agreement."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from compose.camera.axes import mitsuba_from_opencv
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import FilmPositions, frame_positions, pixel_positions
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def picture(traced, camera) -> np.ndarray:
    return np.stack([c.numpy() for c in traced.radiance], axis=-1).reshape(camera.height, camera.width, 3)


def test_radiance_agrees_with_mitsubas_render(backend):
    """Welch's t-test per pixel and channel over independent runs, with the Sidak correction."""
    description = small.corner()
    scene = load_scene(description, max_depth=6)
    tracer, camera = Tracer(scene), scene.camera
    integrator = mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 5})
    runs, spp = 24, 32
    ours, theirs = [], []
    for seed in range(runs):
        ours.append(picture(tracer.trace(camera, frame_positions(camera), spp, seed), camera))
        theirs.append(mi.render(scene.mitsuba, integrator=integrator, spp=spp, seed=1000 + seed).numpy())
    p = stats.ttest_ind(np.array(ours), np.array(theirs), equal_var=False).pvalue
    # Pixels that see the lamp directly are the same in every run and have no variance to test.
    constant = (np.std(ours, axis=0) < 1e-6) & (np.std(theirs, axis=0) < 1e-6)
    np.testing.assert_allclose(np.mean(ours, axis=0)[constant], np.mean(theirs, axis=0)[constant], rtol=1e-5)
    tested = p[~constant]
    assert len(tested) > 2000
    threshold = 1 - (1 - 0.01) ** (1 / len(tested))
    assert tested.min() > threshold
    # A small bias everywhere, too small for any pixel, shows in the mean of the whole picture.
    means = [np.mean(images, axis=(1, 2, 3)) for images in (ours, theirs)]
    assert stats.ttest_ind(*means, equal_var=False).pvalue > 1e-3


def test_the_test_above_can_fail(backend):
    """The same comparison against paths of depth 2 finds the missing bounces."""
    scene = load_scene(small.corner(), max_depth=6)
    camera = scene.camera
    runs = {}
    for depth in (2, 6):
        tracer = Tracer(scene, max_depth=depth)
        runs[depth] = [
            picture(tracer.trace(camera, frame_positions(camera), 32, seed), camera) for seed in range(8)
        ]
    p = stats.ttest_ind(np.array(runs[2]), np.array(runs[6]), equal_var=False).pvalue
    assert np.nanmin(p) < 1e-6


@pytest.mark.parametrize("reflectance", [0.2, 0.7])
def test_a_closed_sphere_has_radiance_one(reflectance):
    scene = load_scene(small.furnace(reflectance), max_depth=40)
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), spp=64, seed=3)
    values = picture(traced, scene.camera).mean(axis=2).ravel()
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert abs(values.mean() - 1) < 4 * error + 1e-4
    assert error < 0.01


def test_a_disc_is_a_part_of_the_frame():
    """Same positions, another order and selection: equal within noise, equal in what has no noise."""
    scene = load_scene(small.corner())
    camera = scene.camera
    indices = np.array([5, 17, 400, 401, 900], dtype=np.uint32)
    tracer, disc, frame = (
        Tracer(scene),
        pixel_positions(mi.UInt32(indices), camera.width),
        frame_positions(camera),
    )
    parts = tracer.trace(camera, disc, 4096, 1).radiance + tracer.auxiliary(camera, disc, 1024, 1).albedo
    wholes = tracer.trace(camera, frame, 512, 2).radiance + tracer.auxiliary(camera, frame, 512, 2).albedo
    for part, whole in zip(parts, wholes, strict=True):
        np.testing.assert_allclose(part.numpy(), whole.numpy()[indices], rtol=0.15, atol=0.02)


def test_samples_are_averaged_over_passes(monkeypatch):
    """Many samples are traced in several passes; their mean must not depend on where the passes end."""
    import pathtrace.trace.tracer as module

    scene = load_scene(small.furnace())
    monkeypatch.setattr(module, "_MAX_LANES", 3 * 32 * 32)
    tracer = Tracer(scene, max_depth=40)
    values = picture(tracer.trace(scene.camera, frame_positions(scene.camera), spp=16), scene.camera)
    assert values.mean() == pytest.approx(1, abs=0.02)


def test_seeds_repeat_and_differ():
    scene = load_scene(small.corner())
    tracer, positions = Tracer(scene), frame_positions(scene.camera)
    first, again, other = (
        picture(tracer.trace(scene.camera, positions, 2, seed), scene.camera) for seed in (7, 7, 8)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_moving_gaze_or_camera_records_nothing_again():
    scene = load_scene(small.corner())
    tracer, camera = Tracer(scene), scene.camera
    positions = pixel_positions(dr.arange(mi.UInt32, 700), camera.width)
    tracer.trace(camera, positions, 1, 0)
    before = tracer._trace_radiance.n_recordings
    for step in range(1, 6):
        moved = pixel_positions(dr.arange(mi.UInt32, 700 - 13 * step) + step, camera.width)
        tracer.trace(camera.resized(32 + step, 32), moved, 1, step)
    assert tracer._trace_radiance.n_recordings == before


def test_film_positions_need_not_be_pixels():
    """At the same place between two pixels, whatever the list around it."""
    scene = load_scene(small.furnace())
    positions = FilmPositions(mi.Float([3.25, 17.5]), mi.Float([8.75, 1.1]))
    traced = Tracer(scene, max_depth=40).trace(scene.camera, positions, 4096)
    np.testing.assert_allclose(traced.radiance[0].numpy(), 1, atol=0.05)


def test_hits_lie_on_the_surfaces():
    scene = load_scene(small.corner())
    camera = scene.camera
    hits = Tracer(scene).hits(camera, frame_positions(camera))
    points = camera.position + camera.rays(camera.pixel_centres()) * hits.distance[:, None]
    plain = hits.unfolded == hits.distance
    on_back = plain & (np.abs(points[:, 2] - 2) < 1e-3)
    on_board = plain & (np.abs(points[:, 2] - 1.2) < 1e-3)
    on_ball = np.abs(np.linalg.norm(points - [0.5, -0.1, 1.0], axis=1) - 0.35) < 1e-3
    assert on_back.any()
    assert on_board.any()
    assert on_ball.any()
    # The ball is a mirror: what is seen in it lies farther away than its surface.
    assert (hits.unfolded[on_ball] >= hits.distance[on_ball]).all()
    assert (hits.unfolded[on_ball] > hits.distance[on_ball] + 0.1).mean() > 0.2
    assert len(np.unique(hits.shape[hits.shape >= 0])) >= 3


def test_mitsuba_sees_a_point_in_the_same_pixel(backend):
    """A tiny lamp, rendered by Mitsuba through a sensor built from our camera."""
    scene = load_scene(small.corner())
    camera = scene.camera.resized(96, 64)
    point = np.array([0.2, 0.1, 1.0])
    expected, _ = camera.project(point[None])
    sensor = small.sensor(96, 64)
    sensor["to_world"] = mi.ScalarTransform4f(mitsuba_from_opencv(camera.camera_to_world))
    lamp = {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": sensor,
        "lamp": {
            "type": "sphere",
            "center": point.tolist(),
            "radius": 0.05,
            "emitter": {"type": "area", "radiance": 1.0},
        },
    }
    image = mi.render(mi.load_dict(lamp), spp=2048).numpy()[..., 0]
    y, x = np.mgrid[0:64, 0:96] + 0.5
    centre = np.array([(image * x).sum(), (image * y).sum()]) / image.sum()
    # The disc of a sphere is seen slightly off its centre, by radius^2 / depth^2; worst seen 0.02 px.
    np.testing.assert_allclose(centre, expected[0], atol=0.05)


def test_the_projected_point_is_exact_in_mitsubas_sensor(backend):
    """To 1e-3 px: the sensor's own direction sampling against Camera.project, with an offset film."""
    description = small.corner()
    description["sensor"]["principal_point_offset_x"] = 0.07
    description["sensor"]["principal_point_offset_y"] = -0.04
    scene = load_scene(description)
    point = np.array([[0.2, 0.1, 1.0]])
    expected, _ = scene.camera.project(point)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p = mi.Point3f(*point[0].tolist())
    sample, _ = scene.mitsuba.sensors()[0].sample_direction(si, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(sample.uv).ravel(), expected[0], atol=1e-3)


def test_each_position_may_have_its_own_number_of_samples():
    """Means agree with those of equal numbers, within their noise; variance falls with the number."""
    scene = load_scene(small.corner())
    camera = scene.camera
    tracer, positions = Tracer(scene), frame_positions(camera)
    counts = np.where(np.arange(positions.count) % 3, 64, 256)
    varied = tracer.trace(camera, positions, counts, seed=1)
    even = tracer.trace(camera, positions, 256, seed=2)
    means, variances = [], []
    for traced, count in ((varied, counts), (even, 256)):
        mean, squares = traced.radiance[0].numpy(), traced.squares[0].numpy()
        means.append(mean)
        variances.append(np.maximum(squares - mean**2, 0) / (count - 1))
    # Over the whole picture, and over the pixels that have few samples and those that have many.
    for part in (counts > 0, counts == 64, counts == 256):
        difference = (means[0] - means[1])[part].sum()
        assert abs(difference) < 4 * np.sqrt(sum(variance[part].sum() for variance in variances))
    # A quarter of the samples, four times the variance, pixel for pixel.
    few = variances[0][counts == 64].sum() / variances[1][counts == 64].sum()
    assert 3 < few < 5
    assert 0.75 < variances[0][counts == 256].sum() / variances[1][counts == 256].sum() < 1.3


def test_many_samples_are_traced_in_parts(monkeypatch):
    """However few lanes there are at once, every sample is traced and counted once."""
    scene = load_scene(small.furnace(0.5), max_depth=40)
    camera = scene.camera.resized(8, 8)
    monkeypatch.setattr("pathtrace.trace.tracer._MAX_LANES", 100)
    tracer, positions = Tracer(scene), frame_positions(camera)
    for spp in (7, np.arange(1, 65)):
        traced = tracer.trace(camera, positions, spp, seed=3)
        assert np.mean([c.numpy().mean() for c in traced.radiance]) == pytest.approx(1, abs=0.03)
