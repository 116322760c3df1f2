"""The tracer against Mitsuba's own render, closed spheres, and areas that can be computed by hand."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from compose.base.traced_samples import Counts
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import mitsuba_from_opencv
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import FilmPositions, box_positions, frame_positions, interleaved, pixel_positions
from pathtrace.trace.tracer import Tracer, auxiliary_spp
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def image_of(traced, camera) -> np.ndarray:
    return np.stack([c.numpy() for c in traced.radiance], axis=-1).reshape(camera.height, camera.width, 3)


# Radiance and albedo of the lit square.
GLOW, ALBEDO = np.array([2.0, 1.0, 0.5]), 0.25


def lit_square() -> dict:
    """A glowing square that covers part of the view, turned so that its edges cross pixels.

    At path depth 1, radiance is its coverage of a pixel times GLOW: it depends on the sample positions alone.
    """
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    square = (
        mi.ScalarTransform4f().translate([0, 0, 2]).rotate([0, 0, 1], 20).rotate([0, 1, 0], 180).scale(0.5)
    )
    return {
        "type": "scene",
        "sensor": {**small.sensor(16, 16, 60.0), "to_world": look},
        "square": {
            "type": "rectangle",
            "to_world": square,
            "bsdf": {"type": "diffuse", "reflectance": ALBEDO},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": GLOW.tolist()}},
        },
    }


@pytest.fixture(scope="module")
def square(backend) -> tuple[Tracer, Camera, FilmPositions]:
    scene = load_scene(lit_square(), max_depth=1)
    return Tracer(scene), scene.camera, frame_positions(scene.camera)


def radiance(square, *args, **options) -> np.ndarray:
    """(N, 3) radiance of the lit square's view."""
    tracer, camera, positions = square
    return interleaved(tracer.trace(camera, positions, *args, **options).radiance)


def test_radiance_is_the_mean_over_each_pixel(square):
    """The square's area in the image: 8 pixels high at fy = 13.86, z = 2 and side 1: 6.93 squared."""
    found = radiance(square, 256)
    np.testing.assert_allclose(found.sum(axis=0), 6.928**2 * GLOW, rtol=0.005)
    assert found.max() == pytest.approx(2, rel=1e-6)
    # Along the edges, pixels are covered in part.
    assert ((found[:, 0] > 0.1) & (found[:, 0] < 1.9)).sum() > 20


def test_squares_are_means_of_squared_samples(square):
    """Samples are 0 or GLOW; so their squares are GLOW times as much."""
    tracer, camera, positions = square
    traced = tracer.trace(camera, positions, 16)
    np.testing.assert_allclose(interleaved(traced.squares), interleaved(traced.radiance) * GLOW, rtol=1e-5)


def test_an_offset_continues_the_sequence(square):
    """Four samples and the four after them are the first eight, whatever the seeds."""
    eight = radiance(square, 8, seed=1, pattern=5)
    first, second = radiance(square, 4, seed=2, pattern=5), radiance(square, 4, seed=3, offset=4, pattern=5)
    assert not np.array_equal(first, second)
    np.testing.assert_allclose((first + second) / 2, eight, atol=1e-6)
    each = radiance(square, 4, offset=np.where(np.arange(256) % 2, 4, 0), pattern=5)
    np.testing.assert_array_equal(each, np.where(np.arange(256)[:, None] % 2, second, first))


@pytest.mark.parametrize("most_lanes", [None, 256, 100])
def test_counts_and_offsets_may_be_on_the_device_or_not(square, monkeypatch, most_lanes):
    """Also if their samples do not fit at once, and if not even one of each position does."""
    if most_lanes:
        monkeypatch.setattr("pathtrace.trace.tracer._MAX_LANES", most_lanes)
    counts, offset = np.arange(256) % 4, np.arange(256) % 3
    there = [mi.UInt32(of.astype(np.uint32)) for of in (counts, offset)]
    found = radiance(square, Counts.of(there[0], 3), seed=1, offset=there[1], pattern=5)
    np.testing.assert_array_equal(found, radiance(square, counts, seed=1, offset=offset, pattern=5))
    ones = np.stack([radiance(square, 1, seed=1, offset=k, pattern=5) for k in range(5)])
    drawn = (np.arange(5) >= offset[:, None]) & (np.arange(5) < (offset + counts)[:, None])
    expected = np.einsum("nk,knc->nc", drawn, ones) / np.maximum(counts, 1)[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_pattern_is_that_of_the_seed_by_default(square):
    np.testing.assert_array_equal(radiance(square, 4, seed=5), radiance(square, 4, seed=9, pattern=5))
    assert not np.array_equal(radiance(square, 4, seed=5), radiance(square, 4, seed=5, pattern=6))
    assert not np.array_equal(radiance(square, 4, seed=5), radiance(square, 4, seed=5, pattern=0))


def test_a_sequence_that_restarts_is_not_that_of_the_next_pattern(square):
    """After 4096 samples, positions are scrambled otherwise; neighbouring patterns must not be alike then."""
    again = radiance(square, 4, offset=4096, pattern=5)
    for pattern in (4, 5, 6):
        assert not np.array_equal(again, radiance(square, 4, pattern=pattern))


@pytest.mark.parametrize("spp", [7, np.arange(256) % 9 + 1])
def test_many_samples_are_traced_in_passes(square, monkeypatch, spp):
    """Each sample once, however few lanes there are at once."""
    whole = radiance(square, spp, seed=3)
    monkeypatch.setattr("pathtrace.trace.tracer._MAX_LANES", 300)
    np.testing.assert_allclose(radiance(square, spp, seed=3), whole, atol=1e-6)


def test_passes_have_random_numbers_of_their_own(monkeypatch):
    """Otherwise, the paths of all passes would be alike, and their mean as noisy as one pass."""
    scene = load_scene(small.corner())
    tracer, camera, positions = Tracer(scene), scene.camera, frame_positions(scene.camera)
    truth = image_of(tracer.trace(camera, positions, 1024, seed=9), camera)
    error = lambda seed: np.mean((image_of(tracer.trace(camera, positions, 16, seed), camera) - truth) ** 2)  # noqa: E731
    whole = np.mean([error(seed) for seed in range(4)])
    monkeypatch.setattr("pathtrace.trace.tracer._MAX_LANES", positions.count)
    assert np.mean([error(seed) for seed in range(4)]) < 1.5 * whole


def test_auxiliary_features_have_the_same_edges_as_radiance(square):
    """With the same pattern, offset and number of samples, both have the square's coverage."""
    tracer, camera, positions = square
    coverage = radiance(square, 4, seed=5, offset=3)[:, 0] / GLOW[0]
    found = tracer.auxiliary(camera, positions, 4, pattern=5, offset=3)
    np.testing.assert_allclose(found.albedo[1].numpy(), coverage * ALBEDO, atol=1e-6)
    np.testing.assert_allclose(found.normal[2].numpy(), -coverage, atol=1e-5)


def test_auxiliary_positions_are_those_of_the_first_sample(square):
    tracer, camera, positions = square
    first, other = (
        interleaved(tracer.auxiliary(camera, positions, 1, pattern=5, offset=offset).position)
        for offset in (3, 4)
    )
    found = tracer.auxiliary(camera, positions, 4, pattern=5, offset=3)
    np.testing.assert_array_equal(interleaved(found.position), first)
    assert not np.array_equal(first, other)
    # Each lies on a ray through its pixel.
    pixels, _ = camera.project(first.astype(np.float64))
    inside = pixels - camera.pixel_centres() + 0.5
    assert inside.min() > -1e-3
    assert inside.max() < 1 + 1e-3
    assert found.gloss.numpy().tolist() == [0] * 256


@pytest.mark.parametrize("cached", [False, True])
@pytest.mark.parametrize("one_pass", [False, True])
def test_features_that_come_along_are_those_of_the_same_samples(cached, one_pass, monkeypatch):
    scene = load_scene(small.corner())
    camera, positions = scene.camera, frame_positions(scene.camera)
    if not one_pass:
        monkeypatch.setattr("pathtrace.trace.tracer._MAX_LANES", positions.count)
    tracer = Tracer(scene, cache=fill_cache(scene, [camera], points=1 << 13) if cached else None)
    with_them = tracer.trace(camera, positions, 3, seed=2, offset=5, features=True)
    without = tracer.trace(camera, positions, 3, seed=2, offset=5)
    assert without.features is None
    found, expected = with_them.features, tracer.auxiliary(camera, positions, 3, pattern=2, offset=5)
    for name in ("radiance", "squares"):
        a, b = (interleaved(getattr(traced, name)) for traced in (with_them, without))
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    for name in ("albedo", "normal", "position"):
        a, b = (interleaved(getattr(features, name)) for features in (found, expected))
        np.testing.assert_allclose(a, b, atol=1e-5)
    assert (found.gloss.numpy() == expected.gloss.numpy()).all()
    # Each position's features are means over as many samples as it has.
    counts = 1 + np.arange(positions.count) % 2
    uneven = interleaved(tracer.trace(camera, positions, counts, 2, 5, features=True).features.albedo)
    for spp in (1, 2):
        even = interleaved(tracer.auxiliary(camera, positions, spp, 2, 5).albedo)
        np.testing.assert_allclose(uneven[counts == spp], even[counts == spp], atol=1e-6)


@pytest.mark.parametrize(("spp", "expected"), [(1, 4), (4, 4), (5, 5), (16, 16), (17, 16), (1024, 16)])
def test_auxiliary_features_take_4_to_16_samples(spp, expected):
    assert auxiliary_spp(spp) == expected


def test_samples_that_are_not_finite_count_as_black():
    """A ball of infinite radiance in red, seen directly and in the light on the walls."""
    description = small.corner()
    infinite = {"type": "area", "radiance": {"type": "rgb", "value": [float("inf"), 1, 1]}}
    description["star"] = {"type": "sphere", "center": [-0.3, 0.3, 0.8], "radius": 0.1, "emitter": infinite}
    scene = load_scene(description)
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), 16)
    found = image_of(traced, scene.camera)
    assert np.isfinite(found).all()
    assert np.isfinite(interleaved(traced.squares)).all()
    (x, y), _ = (values[0] for values in scene.camera.project(np.array([[-0.3, 0.3, 0.8]])))
    assert found[int(y), int(x)].tolist() == [0, 0, 0]


def closed_box(reflectance: float) -> dict[str, Any]:
    """The furnace with plane walls: on a card, 1 % of the paths within a sphere hit it where they start."""
    description = small.furnace(reflectance)
    wall = {key: description["sphere"][key] for key in ("flip_normals", "bsdf", "emitter")}
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(3.0), **wall}
    return {"type": "scene", "sensor": description["sensor"], "box": box}


def test_roulette_ends_paths_early_without_a_bias():
    """In a closed box, radiance stays 1 and gets noisier."""
    scene = load_scene(closed_box(0.5), max_depth=40)
    spread = []
    for depth in (40, 2):
        tracer = Tracer(scene, roulette_depth=depth)
        values = radiance((tracer, scene.camera, frame_positions(scene.camera)), 16)[:, 0]
        assert abs(values.mean() - 1) < 4 * values.std() / np.sqrt(len(values)) + 1e-3
        spread.append(values.std())
    assert spread[1] > 1.5 * spread[0]


def test_radiance_agrees_with_mitsubas_render(backend):
    """Welch's t-test per pixel and channel over independent runs, with the Sidak correction."""
    description = small.corner()
    scene = load_scene(description, max_depth=6)
    tracer, camera = Tracer(scene), scene.camera
    integrator = mi.load_dict({"type": "path", "max_depth": 6, "rr_depth": 5})
    runs, spp = 24, 32
    ours, theirs = [], []
    for seed in range(runs):
        ours.append(image_of(tracer.trace(camera, frame_positions(camera), spp, seed), camera))
        theirs.append(mi.render(scene.mitsuba, integrator=integrator, spp=spp, seed=1000 + seed).numpy())
    p = stats.ttest_ind(np.array(ours), np.array(theirs), equal_var=False).pvalue
    # Pixels that see the lamp directly are the same in every run and have no variance to test.
    constant = (np.std(ours, axis=0) < 1e-6) & (np.std(theirs, axis=0) < 1e-6)
    np.testing.assert_allclose(np.mean(ours, axis=0)[constant], np.mean(theirs, axis=0)[constant], rtol=1e-5)
    tested = p[~constant]
    assert len(tested) > 2000
    threshold = 1 - (1 - 0.01) ** (1 / len(tested))
    assert tested.min() > threshold
    # A bias too small to show in any pixel shows in the mean of the whole image.
    means = [np.mean(images, axis=(1, 2, 3)) for images in (ours, theirs)]
    assert stats.ttest_ind(*means, equal_var=False).pvalue > 1e-3


def test_missing_bounces_would_be_noticed(backend):
    """The test above fails for paths of depth 2."""
    scene = load_scene(small.corner(), max_depth=6)
    camera = scene.camera
    runs = {}
    for depth in (2, 6):
        tracer = Tracer(scene.at_depth(depth))
        runs[depth] = [
            image_of(tracer.trace(camera, frame_positions(camera), 32, seed), camera) for seed in range(8)
        ]
    p = stats.ttest_ind(np.array(runs[2]), np.array(runs[6]), equal_var=False).pvalue
    assert np.nanmin(p) < 1e-6


@pytest.mark.parametrize("reflectance", [0.2, 0.7])
def test_a_closed_box_has_radiance_one(reflectance):
    scene = load_scene(closed_box(reflectance), max_depth=40)
    traced = Tracer(scene).trace(scene.camera, frame_positions(scene.camera), spp=64, seed=3)
    values = image_of(traced, scene.camera).mean(axis=2).ravel()
    error = values.std(ddof=1) / np.sqrt(len(values))
    assert abs(values.mean() - 1) < 4 * error + 1e-4
    assert error < 0.01


def test_a_disc_is_a_part_of_the_frame():
    """A selection of a frame's pixels has the frame's radiance and albedo there, within noise."""
    scene = load_scene(small.corner())
    camera = scene.camera
    indices = np.array([5, 17, 400, 401, 900], dtype=np.uint32)
    tracer, frame = Tracer(scene), frame_positions(camera)
    disc = pixel_positions(mi.UInt32(indices), camera.width)
    parts = tracer.trace(camera, disc, 4096, 1).radiance + tracer.auxiliary(camera, disc, 1024, 1).albedo
    wholes = tracer.trace(camera, frame, 512, 2).radiance + tracer.auxiliary(camera, frame, 512, 2).albedo
    for part, whole in zip(parts, wholes, strict=True):
        np.testing.assert_allclose(part.numpy(), whole.numpy()[indices], rtol=0.15, atol=0.02)


def test_seeds_repeat_and_differ():
    scene = load_scene(small.corner())
    tracer, positions = Tracer(scene), frame_positions(scene.camera)
    first, again, other = (
        image_of(tracer.trace(scene.camera, positions, 2, seed), scene.camera) for seed in (7, 7, 8)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("cached", [False, True])
@pytest.mark.usefixtures("no_garbage")
def test_a_moving_gaze_or_camera_records_nothing_again(cached):
    scene = load_scene(small.corner())
    camera = scene.camera
    tracer = Tracer(scene, cache=fill_cache(scene, [camera], points=1 << 13) if cached else None)

    def frame(step: int) -> None:
        moved = pixel_positions(dr.arange(mi.UInt32, 700 - 13 * step) + step, camera.width)
        view = camera.resized(32 + step, 32)
        tracer.trace(view, moved, 1, step, offset=step)
        tracer.auxiliary(view, moved, 4, pattern=step)

    for step in range(12):
        frame(step)
    assert tracer._trace_radiance._recorded.n_recordings == 1
    assert tracer._trace_auxiliary._recorded.n_recordings == 1


def test_a_moving_gaze_or_camera_compiles_nothing_again():
    scene = load_scene(small.corner())
    tracer, camera = Tracer(scene), scene.camera

    def frame(step: int) -> list[bool]:
        """Whether each kernel of a frame was in memory; the cache on disk may be an earlier run's."""
        pixels = dr.arange(mi.UInt32, 700 - 13 * step) + step
        dr.eval(pixels)
        view = camera.resized(camera.width + step, 32)
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            moved = pixel_positions(pixels, view.width)
            tracer.trace(view, moved, 1, step, offset=step)
            tracer.auxiliary(view, moved, 4, pattern=step)
            tracer.hits(view, moved)
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
        return [bool(kernel["cache_hit"] and not kernel["cache_disk"]) for kernel in kernels]

    # Numbers that no other test uses: kernels with them compiled in would be known otherwise.
    assert len(frame(30)) >= 3
    # Not each: a few kernels have variants for the alignment of their arrays.
    assert any(all(frame(step)) for step in range(31, 41))


def test_film_positions_need_not_be_pixels():
    """Boxes that lie across pixels see a closed sphere's radiance as well."""
    scene = load_scene(small.furnace())
    positions = FilmPositions(mi.Float([3.25, 17.5]), mi.Float([8.75, 1.1]))
    traced = Tracer(scene.at_depth(40)).trace(scene.camera, positions, 4096)
    np.testing.assert_allclose(traced.radiance[0].numpy(), 1, atol=0.05)


def test_hits_lie_on_the_surfaces():
    scene = load_scene(small.corner())
    camera = scene.camera
    hits = Tracer(scene).hits(camera, frame_positions(camera))
    points = camera.position + camera.rays(camera.pixel_centres()) * hits.distance[:, None]
    direct = hits.unfolded == hits.distance
    on_back = direct & (np.abs(points[:, 2] - 2) < 1e-3)
    on_board = direct & (np.abs(points[:, 2] - 1.2) < 1e-3)
    on_ball = np.abs(np.linalg.norm(points - [0.5, -0.1, 1.0], axis=1) - 0.35) < 1e-3
    assert on_back.any()
    assert on_board.any()
    assert on_ball.any()
    assert (on_back | on_board | on_ball).mean() > 0.95
    # The ball is a mirror, in which everything seems to lie near its surface.
    assert (hits.unfolded[on_ball] == hits.distance[on_ball]).mean() > 0.99
    # Each surface is one shape of the scene, at its index.
    for mask, centre in ((on_back, [0, 0, 2]), (on_board, [-0.6, 0.1, 1.2]), (on_ball, [0.5, -0.1, 1.0])):
        (index,) = set(hits.shape[mask].tolist())
        box = scene.mitsuba.shapes()[index].bbox()
        np.testing.assert_allclose(np.ravel(box.center()), centre, atol=1e-5)
    assert hits.distance.dtype == hits.unfolded.dtype == np.float32
    assert hits.shape.dtype == np.int32


def test_ctrl_c_while_rays_are_followed_stays_what_it_is(monkeypatch):
    def interrupting(*_: object) -> None:
        raise KeyboardInterrupt

    scene = load_scene(small.corner())
    monkeypatch.setattr(dr, "max", interrupting)
    with pytest.raises(KeyboardInterrupt):
        Tracer(scene).hits(scene.camera, frame_positions(scene.camera))


def test_hits_go_through_the_middle_of_each_position():
    """Of pixels, and of boxes that are 4 pixels wide and 2 high."""
    scene = load_scene(small.furnace())
    camera = scene.camera
    left, top = np.array([0.0, 12, 28]), np.array([0.0, 20, 30])
    boxes = box_positions(left, top, np.full(3, 4.0), np.full(3, 2.0))
    hits = Tracer(scene).hits(camera, boxes)
    middle = np.stack([left + 2, top + 1], axis=1)
    points = camera.position + camera.rays(middle) * hits.distance[:, None]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 3, rtol=1e-5)


def _square(z: float, bsdf: dict[str, Any], turn: float = 180) -> dict[str, Any]:
    """Of side 1 before the camera of `small.sensor`, which it faces unless it is turned less."""
    to_world = mi.ScalarTransform4f().translate([0, 0, z]).rotate([0, 1, 0], turn).scale(0.5)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


@pytest.mark.parametrize(
    ("shape", "beyond"),
    [
        pytest.param(lambda: {"a": _square(0.4, {"type": "conductor"})}, True, id="flat mirror"),
        pytest.param(lambda: {"a": _square(0.4, {"type": "thindielectric"})}, True, id="pane"),
        pytest.param(
            lambda: {
                "a": _square(0.4, {"type": "dielectric"}),
                "b": _square(0.41, {"type": "dielectric"}, 0),
            },
            True,
            id="two faces of a pane",
        ),
        pytest.param(
            lambda: {
                "a": {
                    "type": "sphere",
                    "center": [0.1, 0, 0.4],
                    "radius": 0.3,
                    "bsdf": {"type": "conductor"},
                }
            },
            False,
            id="curved mirror",
        ),
        pytest.param(lambda: {"a": _square(0.4, {"type": "diffuse"})}, False, id="wall"),
    ],
)
def test_the_sky_is_as_far_away_in_what_is_flat(shape, beyond):
    sky = {"type": "constant", "radiance": 1.0}
    scene = load_scene({"type": "scene", "sensor": small.sensor(), "sky": sky, **shape()})
    hits = Tracer(scene).hits(scene.camera, frame_positions(scene.camera))
    hit = np.isfinite(hits.distance)
    assert 0.05 < hit.mean() < 0.95
    # A ray that grazes a ball is hardly bent.
    assert (np.isinf(hits.unfolded[hit]) == beyond).mean() > 0.99
    assert np.isinf(hits.unfolded[~hit]).all()


def test_panes_show_what_is_behind_them_and_their_edges_lie_where_they_are():
    """A glass plate before a wall: through its face, one sees the wall; its edge bends what it shows."""
    plate = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([-0.3, 0, 0.4]).scale([0.3, 0.2, 0.05]),
        "bsdf": {"type": "dielectric"},
    }
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale(5),
    }
    shapes = {"sky": {"type": "constant"}, "plate": plate, "wall": wall}
    scene = load_scene({"type": "scene", "sensor": small.sensor(128, 128), **shapes})
    hits = Tracer(scene).hits(scene.camera, frame_positions(scene.camera))
    rays = scene.camera.rays(scene.camera.pixel_centres())
    to_wall = (1 - scene.camera.position[2]) / rays[:, 2]
    on_plate = hits.distance < 0.9 * to_wall
    points = scene.camera.position + rays * hits.distance[:, None]
    face = on_plate & (np.abs(points[:, 2] - 0.35) < 1e-4)
    edge = on_plate & (np.abs(points[:, 0]) < 1e-4)
    assert face.any()
    assert edge.any()
    np.testing.assert_array_equal(hits.unfolded[edge], hits.distance[edge])
    # Within what the plate shifts the ray by; from some of the face, one looks at an edge from inside.
    behind = np.abs(hits.unfolded[face] - to_wall[face]) < 0.1
    assert behind.mean() > 0.8
    assert (hits.unfolded[face] == hits.distance[face])[~behind].all()


def test_rays_that_hit_nothing_have_no_shape():
    scene = load_scene(lit_square())
    hits = Tracer(scene).hits(scene.camera, frame_positions(scene.camera))
    missed = hits.shape == -1
    assert missed.any()
    assert not missed.all()
    assert np.isinf(hits.distance[missed]).all()
    assert np.isinf(hits.unfolded[missed]).all()
    assert np.isfinite(hits.distance[~missed]).all()


def test_mitsuba_sees_a_point_in_the_same_pixel(backend):
    """A tiny lamp, rendered by Mitsuba through a sensor with the camera's pose."""
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


def test_each_position_may_have_its_own_number_of_samples():
    """Means agree with those of equal counts within their noise; the variance falls with the count."""
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
    # Over the whole image, and over the pixels with few and with many samples.
    for part in (counts > 0, counts == 64, counts == 256):
        difference = (means[0] - means[1])[part].sum()
        assert abs(difference) < 4 * np.sqrt(sum(variance[part].sum() for variance in variances))
    # A quarter of the samples, four times the variance, pixel for pixel.
    few = variances[0][counts == 64].sum() / variances[1][counts == 64].sum()
    assert 3 < few < 5
    assert 0.75 < variances[0][counts == 256].sum() / variances[1][counts == 256].sum() < 1.3
