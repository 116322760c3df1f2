"""Methods of rendering a frame, and the path-traced baselines."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.evaluation import methods as path_traced
from hybrid.evaluation.methods import (
    Axis,
    Enlarged,
    FullTrace,
    HybridMethod,
    Method,
    Rmfr,
    SplatsAlone,
    Tuning,
    Warp,
    WarpTuning,
    enlarged,
    families,
    warped,
)
from hybrid.measure.image_metrics import psnr, registration_px
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from pathtrace.region.neighbourhood import unseen_views, view_time
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA
from tests.hybrid.forests import moving_forest, rough_forest
from tests.moving import moving_corner

pytestmark = pytest.mark.usefixtures("backend")
GAZE = Gaze(0.3, 0.6)


@pytest.fixture(scope="module")
def renderer(backend) -> Renderer:
    scene = load_scene(small.corner())
    return Renderer(scene, rough_forest(scene))


def test_a_frame_is_that_of_the_renderer_at_the_asked_view(renderer):
    settings = FrameSettings(gaze=(0.9, 0.9), spp=2, fovea="denoised")
    camera = renderer.scene.camera.resized(48, 40)
    method: Method = HybridMethod(renderer, settings)
    made = method.render(View(camera), GAZE, 7)
    expected = renderer.frame(replace(settings, gaze=GAZE, camera=camera), 7)
    np.testing.assert_array_equal(made.image, expected.composite)
    assert made.milliseconds.keys() == expected.milliseconds.keys()
    assert made.milliseconds["total"] > 0


def test_rays_are_the_samples_in_the_disc_over_the_pixels_of_the_frame(renderer):
    """A disc of 16 of 64 pixels radius covers pi / 16; in the band of a raw one rays thin out to none."""
    camera = renderer.scene.camera.resized(64, 64)
    fused = HybridMethod(renderer, FrameSettings(fov_a=25, fov_b=25, spp=3))
    assert fused.rays(camera, Gaze()) == pytest.approx(3 * np.pi / 16, rel=0.02)
    wide = HybridMethod(renderer, FrameSettings(fov_a=25, fov_b=0, spp=3, fovea="raw"))
    # The weight falls linearly from the centre: a cone, a third of the cylinder.
    assert wide.rays(camera, Gaze()) == pytest.approx(np.pi / 16, rel=0.02)
    # Half of the disc lies outside.
    assert fused.rays(camera, Gaze(0, 0.5)) == pytest.approx(1.5 * np.pi / 16, rel=0.02)


def test_settings_are_json(renderer):
    method = HybridMethod(renderer, FrameSettings(fov_a=30, fov_b=10, spp=2))
    assert json.loads(json.dumps(method.settings)) == {"fovea": "fused", "spp": 2, "fov_a": 30, "fov_b": 10}


def test_the_finest_layer_is_shown_at_full_rate_whatever_the_gaze(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    periphery = Periphery(arrays, forest)
    method: Method = SplatsAlone(periphery)
    one, other = (method.render(View(scene.camera), gaze, 0) for gaze in (Gaze(), Gaze(0.1, 0.1)))
    np.testing.assert_array_equal(one.image, other.image)
    finest = FrameSettings(layers=(3, 3))
    np.testing.assert_array_equal(one.image, periphery.whole(scene.camera, finest).numpy())
    coarsest = periphery.whole(scene.camera, FrameSettings(layers=(1, 1))).numpy()
    assert np.abs(one.image - coarsest).max() > 0.05
    assert set(one.milliseconds) == {"splat", "total"}


def test_no_rays_are_traced_and_the_finest_layer_is_counted(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    method = SplatsAlone(Periphery(arrays, forest))
    assert method.rays(scene.camera, Gaze()) == 0
    assert method.settings == {"gaussians": forest.counts[-1]}
    assert forest.counts[-1] == max(forest.counts)


WIDTH, HEIGHT = 48, 32


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene("cornell"))


def image(tracer: Tracer, spp: float, seed: int = 3, denoised: bool = False, clock: PassClock | None = None):
    camera = tracer.scene.camera.resized(WIDTH, HEIGHT)
    positions, clock = frame_positions(camera), clock or PassClock()
    return FullTrace(tracer, spp, denoised).traced(camera, positions, WIDTH, seed, clock)


def test_a_fraction_of_a_sample_goes_to_a_fraction_of_the_pixels(tracer, monkeypatch):
    asked, trace = [], tracer.trace

    def recorded(camera, positions, spp, seed):
        asked.append(spp)
        return trace(camera, positions, spp, seed)

    monkeypatch.setattr(tracer, "trace", recorded)
    one, same, other = (image(tracer, 2.25, seed) for seed in (3, 3, 4))
    image(tracer, 2.0)
    assert asked[0].mean() == pytest.approx(2.25)
    assert set(asked[0]) == {2, 3}
    # Scattered over the frame, not one part of it.
    assert 0.15 < (asked[0][: 24 * 32] == 3).mean() < 0.35
    assert asked[3] == 2
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    many, more = image(tracer, 128), image(tracer, 128.5)
    assert many.mean() == pytest.approx(more.mean(), rel=0.06)


def test_denoising_removes_noise_and_is_timed(tracer):
    truth = image(tracer, 256, seed=9)
    clocks = PassClock(), PassClock()
    raw, denoised = (image(tracer, 4, denoised=flag, clock=clocks[flag]) for flag in (False, True))
    assert raw.shape == denoised.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(denoised - truth).mean() < 0.85 * np.abs(raw - truth).mean()
    assert list(clocks[0].milliseconds()) == ["trace", "total"]
    assert list(clocks[1].milliseconds()) == ["trace", "denoise", "total"]


@pytest.mark.parametrize("spp", [1.5, 64])
def test_the_better_denoiser_is_used_at_any_sample_count(tracer, monkeypatch, spp):
    from pathtrace.trace.traced_images import TracedImage

    asked = []
    monkeypatch.setattr(
        TracedImage, "denoised", lambda self, quick=False: (asked.append(quick), self.radiance)[1]
    )
    image(tracer, spp, denoised=True)
    assert asked == [False]


TRACED_GAZE = Gaze(0.4, 0.55)


def test_an_enlarged_frame_of_full_size_is_the_full_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    full = FullTrace(tracer, 2, denoised=False).render(View(camera), TRACED_GAZE, 3)
    same = Enlarged(tracer, 2, False, 1.0).render(View(camera), TRACED_GAZE, 3)
    np.testing.assert_allclose(same.image, full.image, rtol=1e-5, atol=1e-6)


def test_passes_are_named_and_add_up(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    for method, passes in (
        (FullTrace(tracer, 1, denoised=False), {"trace"}),
        (FullTrace(tracer, 1, denoised=True), {"trace", "denoise"}),
        (Enlarged(tracer, 1, False, 0.5), {"trace", "enlarge"}),
        (Rmfr(tracer, 1, True, 0.4, 1.5), {"trace", "denoise", "enlarge"}),
    ):
        milliseconds = method.render(View(camera), TRACED_GAZE, 0).milliseconds
        assert set(milliseconds) == {*passes, "total"}
        assert milliseconds["total"] == pytest.approx(sum(milliseconds[name] for name in passes))


@pytest.mark.parametrize("kind", ["enlarged", "rmfr"])
def test_baselines_line_up_and_converge_to_a_blurred_full_frame(tracer, kind):
    """With many samples nothing but their lower resolution is left."""
    camera = tracer.scene.camera.resized(96, 96)
    truth = FullTrace(tracer, 64, denoised=True).render(View(camera), TRACED_GAZE, 0).image
    if kind == "enlarged":
        image = Enlarged(tracer, 64, False, 0.25).render(View(camera), TRACED_GAZE, 1).image
    else:
        image = Rmfr(tracer, 64, False, 0.4, 1.5).render(View(camera), TRACED_GAZE, 1).image
    assert image.shape == truth.shape
    assert image.min() >= 0
    assert psnr(image, truth) > 20
    shift = registration_px(image, truth)
    assert shift is None or shift < 0.35
    if kind == "rmfr":
        # It is sharpest, and so best, at the gaze.
        near, far = np.s_[42:62, 28:48], np.s_[:20, -20:]
        error = np.abs(image - truth)
        assert error[near].mean() / truth[near].mean() < error[far].mean() / truth[far].mean()


def test_enlarging_is_bicubic_and_keeps_pixels_where_they_are(tracer, monkeypatch):
    """A ramp, traced with half of the resolution, comes back as the same ramp; overshoot is cut at 0."""

    def ramp(method, camera, positions, columns, *rest):
        rows = positions.count // columns
        across = (np.arange(columns) + 0.5) * camera.width / columns
        return np.broadcast_to(across[None, :, None], (rows, columns, 3)).astype(np.float32).copy()

    monkeypatch.setattr(path_traced._PathTraced, "traced", ramp)
    camera = tracer.scene.camera.resized(48, 32)
    image = Enlarged(tracer, 1, False, 0.25).render(View(camera), TRACED_GAZE, 0).image
    assert image.shape == (32, 48, 3)
    expected = np.broadcast_to((np.arange(48) + 0.5)[None, :, None], (32, 48, 3))
    # A ramp comes back exactly only in the limit; an offset of half a pixel would be 0.5 or more.
    np.testing.assert_allclose(image[:, 4:-4], expected[:, 4:-4], atol=0.1)

    def edge(*arguments):
        image = ramp(*arguments)
        return np.where(image < 24, 0, 5).astype(np.float32)

    monkeypatch.setattr(path_traced._PathTraced, "traced", edge)
    image = Enlarged(tracer, 1, False, 0.25).render(View(camera), TRACED_GAZE, 0).image
    assert image.min() == 0
    assert image.max() > 5.1


def test_rays_are_what_is_traced(tracer, monkeypatch):
    """Columns and rows of the traced image, times its samples, over the pixels of the frame."""
    camera = tracer.scene.camera.resized(90, 60)
    traced = []

    def counted(method, camera, positions, columns, *rest):
        traced.append(positions.count * method.spp / (camera.width * camera.height))
        return np.zeros((positions.count // columns, columns, 3), dtype=np.float32)

    monkeypatch.setattr(path_traced._PathTraced, "traced", counted)
    for method, rays in (
        (FullTrace(tracer, 3, denoised=False), 3),
        (FullTrace(tracer, 1.25, denoised=True), 1.25),
        (Enlarged(tracer, 2, True, 0.25), 0.5),
        (Enlarged(tracer, 2, True, 1e-9), 2 / 5400),
        (Rmfr(tracer, 2, False, 0.1, 3.0), 2 / 9),
    ):
        assert method.rays(camera, TRACED_GAZE) == pytest.approx(rays)
        method.render(View(camera), TRACED_GAZE, 0)
        assert traced[-1] == pytest.approx(rays)


def test_settings_tell_methods_apart_in_tables(tracer):
    assert FullTrace(tracer, 2.5, denoised=True).settings == {"spp": 2.5}
    assert Enlarged(tracer, 4, True, 0.25).settings == {"spp": 4, "scale": 0.5}
    rmfr = Rmfr(tracer, 2, True, 0.4, 1.5).settings
    assert rmfr == {"spp": 2, "f": 0.4, "sigma": 1.5, "denoised": "true"}


def test_the_same_seed_gives_the_same_frame(tracer):
    camera = tracer.scene.camera.resized(48, 32)
    method = Rmfr(tracer, 2, True, 0.1, 2.0)
    one, same, other = (method.render(View(camera), TRACED_GAZE, seed).image for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0


GAZES = (0.5, 0.2, 0.0, 1.0)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("f", [0.02, 0.1, 3.0])
def test_frame_and_buffer_map_to_each_other(gaze, f):
    axis = Axis(gaze, f, 512, 197)
    pixels = np.linspace(0, 512, 401)
    there = axis.buffer_of(pixels)
    np.testing.assert_allclose(axis.frame_of(there), pixels, atol=1e-9)
    assert (np.diff(there) > 0).all()
    np.testing.assert_allclose(there[[0, -1]], [0, 197], atol=1e-12)
    np.testing.assert_allclose(axis.buffer_of(np.array([gaze * 512])), gaze * 197, atol=1e-12)


def test_the_papers_setting_is_dense_in_the_middle_only():
    """sigma 2.6 and f 0.1: 2.3 samples per pixel and side at the gaze, one in 16 pixels at the edge."""
    axis = Axis(0.5, 0.1, 2600, 1000)
    density = np.diff(axis.buffer_of(np.arange(2601.0)))
    assert density[1300] == pytest.approx(6 / 2.6, rel=0.01)
    assert density[0] == pytest.approx(1 / 6 / 2.6, rel=0.01)
    assert density[1300 + 125] > 1 > density[1300 + 135]


@pytest.mark.parametrize("gaze", GAZES)
def test_boxes_cover_the_frame_once(gaze):
    warp = Warp.of(Gaze(gaze, 0.4), 64, 48, 0.1, 2.6)
    left, top, width, height = warp.boxes()
    assert len(left) == 25 * 18
    assert (width * height).sum() == pytest.approx(64 * 48)
    assert min(left.min(), top.min()) == pytest.approx(0, abs=1e-12)
    assert (left + width).max() == pytest.approx(64)
    assert (top + height).max() == pytest.approx(48)


def test_a_smooth_picture_comes_back():
    warp = Warp.of(Gaze(0.4, 0.6), 96, 64, 0.3, 1.0)
    left, top, width, height = warp.boxes()
    picture = lambda x, y: np.stack([x / 96, y / 64, x * y / 96 / 64], axis=-1)  # noqa: E731
    buffer = picture(left + width / 2, top + height / 2).reshape(64, 96, 3).astype(np.float32)
    x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
    np.testing.assert_allclose(warp.frame(buffer)[2:-2, 2:-2], picture(x, y)[2:-2, 2:-2], atol=0.02)


def test_the_gazes_surroundings_are_sharp():
    """A checkerboard of single pixels survives where the buffer is denser than the frame, nowhere else."""
    size, warp = 256, Warp.of(Gaze(), 256, 256, 0.05, 2.0)
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    left, top, width, height = warp.boxes()
    column, row = np.floor(left + width / 2).astype(int), np.floor(top + height / 2).astype(int)
    board = lambda x, y: ((x + y) % 2).astype(np.float32)  # noqa: E731
    buffer = np.repeat(board(column, row).reshape(128, 128, 1), 3, axis=2)
    error = np.abs(warp.frame(buffer)[..., 0] - board(x, y))
    assert error[126:130, 126:130].mean() < 0.3 < error[:, :64].mean()


def test_a_buffer_has_at_least_one_pixel():
    warp = Warp.of(Gaze(0.2, 0.9), 6, 4, 0.1, 100.0)
    assert (warp.across.buffer, warp.down.buffer) == (1, 1)
    left, top, width, height = warp.boxes()
    assert (left[0], top[0], width[0], height[0]) == pytest.approx((0, 0, 6, 4))
    frame = warp.frame(np.full((1, 1, 3), 0.7, dtype=np.float32))
    np.testing.assert_allclose(frame, np.full((4, 6, 3), 0.7), rtol=1e-6)


def test_between_pixels_a_frame_is_linear():
    """With f so large that the mapping only scales."""
    warp = Warp.of(Gaze(0.5, 0.5), 4, 4, 1e9, 2.0)
    buffer = np.zeros((2, 2, 3), dtype=np.float32)
    buffer[:, 1] += 1
    buffer[1] += 2
    # Frame centres map to 0.25, 0.75, 1.25 and 1.75; those of the buffer are at 0.5 and 1.5.
    steps = np.array([0, 0.25, 0.75, 1])
    expected = steps[None, :] + 2 * steps[:, None]
    np.testing.assert_allclose(warp.frame(buffer)[..., 0], expected, atol=1e-5)


WIDE = CAMERA.resized(96, 64)
TUNING = Tuning(WarpTuning(0.4, 2, False), WarpTuning(0.1, 1, True), 2)


@pytest.mark.parametrize("rays", [0.2, 1.3, 2.01, 5.5])
def test_all_families_take_the_rays_that_they_are_given(rays):
    known = families(None, TUNING)
    assert list(known) == [
        "full",
        "full, denoised",
        "enlarged",
        "enlarged, denoised",
        "rmfr",
        "rmfr, tuned",
        "rmfr, tuned for the fovea",
    ]
    for name, family in known.items():
        # The cheapest full frame has one sample of each pixel, FPC's buffer one of each of its own.
        least = {"full": 1.0, "full, denoised": 1.0, "rmfr": 1 / 2.6**2}.get(name, 0.0)
        method = family(rays)
        assert method.rays(WIDE, TRACED_GAZE) == pytest.approx(max(rays, least), rel=0.03), name
        # No smaller image has more pixels than the frame.
        assert getattr(method, "share", 1.0) <= 1 + 1e-9
        assert name == "rmfr" or getattr(method, "sigma", 1.0) >= 1 - 1e-9


def test_families_have_the_settings_that_their_names_promise():
    known = {name: family(0.4) for name, family in families(None, TUNING).items()}
    denoised = {name for name, method in known.items() if method.denoised}
    assert denoised == {"full, denoised", "enlarged, denoised", "rmfr, tuned for the fovea"}
    # Foveated Path Culling's own setting.
    assert (known["rmfr"].f, known["rmfr"].sigma) == (0.1, 2.6)
    assert (known["rmfr, tuned"].f, known["rmfr, tuned"].spp) == (0.4, 2)
    assert (known["rmfr, tuned for the fovea"].f, known["rmfr, tuned for the fovea"].spp) == (0.1, 1)
    assert (known["enlarged"].spp, known["enlarged, denoised"].spp) == (1, 2)


def test_settings_that_are_best_for_both_stand_once():
    same = Tuning(TUNING.frame, TUNING.frame, 2)
    assert "rmfr, tuned for the fovea" not in families(None, same)


def test_few_rays_make_images_smaller_and_many_give_them_more_samples():
    """Half a ray per pixel at 2 samples: a quarter of the pixels; 2.5 rays: 3 samples of 5 in 6 pixels."""
    small, large = (enlarged(None, 2, rays, denoised=False) for rays in (0.5, 2.5))
    assert (small.share, small.spp) == (0.25, 2)
    assert (large.share, large.spp) == (pytest.approx(2.5 / 3), 3)
    small, large = (warped(None, TUNING.frame, rays) for rays in (0.5, 2.5))
    assert (small.sigma, small.spp) == (2.0, 2)
    assert (large.sigma, large.spp) == (pytest.approx((3 / 2.5) ** 0.5), 3)


def test_a_tuning_comes_back_from_json():
    assert Tuning.restored(asdict(TUNING)) == TUNING


METHODS = ("hybrid", "splats", "full", "enlarged", "rmfr")


@pytest.fixture(scope="module")
def scene(backend, tmp_path_factory) -> Scene:
    return moving_corner(tmp_path_factory.mktemp("moving"))


@pytest.fixture(scope="module")
def forest(scene) -> Forest:
    return moving_forest(scene)


def method_of(name: str, scene: Scene, forest: Forest) -> Method:
    renderer = Renderer(scene, forest)
    return {
        "hybrid": HybridMethod(renderer, FrameSettings(fovea="denoised", spp=2)),
        "splats": SplatsAlone(Periphery(device_arrays(), forest)),
        "full": FullTrace(renderer.tracer, 8, denoised=True),
        "enlarged": Enlarged(renderer.tracer, 8, True, 1.0),
        "rmfr": Rmfr(renderer.tracer, 8, True, 0.4, 1.5),
    }[name]


@pytest.mark.parametrize("name", METHODS)
def test_each_method_shows_the_time_of_its_view(scene, forest, name):
    """Whatever the scene showed before."""
    method, camera = method_of(name, scene, forest), scene.camera.resized(64, 64)
    images = {}
    for time in (0.0, 0.9, 0.0):
        made = method.render(View(camera, time), Gaze(), 3).image
        if time in images:
            np.testing.assert_allclose(made, images[time], atol=1e-6)
        images[time] = made
    assert np.abs(images[0.0] - images[0.9]).max() > 0.05


def test_views_to_measure_on_have_times_between_those_of_training(scene):
    views = unseen_views(scene, 5, 32, 32)
    assert [view.time for view in views] == [view_time(scene, number + 0.5) for number in range(5)]
    trained = [view_time(scene, number) for number in range(200)]
    assert min(abs(view.time - time) for view in views for time in trained) > 1e-4
    still = load_scene(small.corner())
    assert [view.time for view in unseen_views(still, 3, 32, 32)] == [0, 0, 0]
