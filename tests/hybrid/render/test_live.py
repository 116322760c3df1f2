"""Frames for a window: quick, better while nothing moves, and the same periphery from kept layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.measure.image_metrics import psnr
from hybrid.render import disc_images as disc
from hybrid.render import fovea
from hybrid.render import frame_renderer as renderer
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from pathtrace.scene.scene import load_scene
from splat.raster.tiles import TILE
from tests import small
from tests.compose.arrays_of import host, numbers
from tests.hybrid.render.passes import waits


@pytest.fixture(scope="module")
def live(scene, forest) -> LiveRenderer:
    return LiveRenderer(scene, forest)


@pytest.fixture
def settings(live) -> FrameSettings:
    """Of a window of 96 x 80; nothing is known from earlier frames."""
    live.forget()
    camera = live.scene.camera.resized(96, 80)
    return replace(INTERACTIVE, acuity_model="none", camera=camera)


@pytest.fixture
def denoisers(monkeypatch):
    """Names of the denoisers that frames use: of samples, and of what splats are relit by."""
    called = []
    for module, name in ((disc, "denoise"), (fovea, "smooth")):
        original = getattr(module, name)

        def noted(*arguments, name=name, original=original):
            called.append(name)
            return original(*arguments)

        monkeypatch.setattr(module, name, noted)
    return called


def shows_all(frame: Frame) -> bool:
    """Whether the underlay shows splats outside the tiles around the disc."""
    tiles = np.kron(frame.region.foveal_tiles(TILE), np.ones((TILE, TILE), dtype=bool))
    return bool((frame.underlay.radiance.numpy()[~tiles] > 0).any())


def test_without_a_disc_moving_and_still_frames_are_the_splats(live, settings):
    settings = replace(settings, fov_a=0, fov_b=0)
    expected = live.splats(settings)
    for number in range(3):
        np.testing.assert_allclose(live.frame(settings, number).composite, expected, atol=1e-6)


def test_each_pixel_is_the_weighted_mean_of_both(live, settings):
    whole = live.splats(settings)
    for number in range(2):
        frame = live.frame(settings, number)
        weight = frame.weight_image()[..., None]
        expected = weight * frame.of_disc(frame.fovea.radiance) + (1 - weight) * whole
        np.testing.assert_allclose(frame.composite, expected, atol=1e-5)
        assert frame.settings == replace(settings, camera=frame.camera)
        assert frame.nodes_drawn > 0


def test_samples_add_up_while_nothing_moves(live, settings):
    for number in range(3):
        frame = live.frame(replace(settings, spp=2), number)
        assert (numbers(frame.fovea.samples, "count") == 2 * (number + 1)).all()
    live.forget()
    assert (numbers(live.frame(settings).fovea.samples, "count") == 1).all()


def test_the_whole_frame_is_drawn_under_the_disc_once_the_camera_stands_still(live, settings):
    moving, still = live.frame(settings, 0), live.frame(settings, 1)
    assert not shows_all(moving)
    np.testing.assert_array_equal(still.underlay.radiance.numpy(), live.splats(settings))
    assert shows_all(still)
    cropped = [frame.underlay.radiance.numpy()[frame.region.box] for frame in (moving, still)]
    np.testing.assert_allclose(*cropped, atol=1e-6)
    # The gaze may move meanwhile, the camera may not.
    assert shows_all(live.frame(replace(settings, gaze=(0.3, 0.4)), 2))
    turned = replace(settings, camera=replace(settings.camera, fx=settings.camera.fx * 1.1))
    assert not shows_all(live.frame(turned, 3))
    assert not shows_all(live.frame(settings, 4))
    live.forget()
    assert not shows_all(live.frame(settings, 5))


def test_the_periphery_of_a_still_camera_follows_the_gaze(live, scene, forest, settings):
    settings = replace(settings, acuity_model="fov-gs", display="hmd", fov_a=10, fov_b=10)
    live.frame(settings)
    shown = []
    for gaze in ((0.1, 0.2), (0.9, 0.8)):
        moved = replace(settings, gaze=gaze)
        still = np.array(live.frame(moved).periphery)
        alone = renderer.Renderer(scene, forest).frame(moved).periphery
        assert psnr(still, alone) > 28
        shown.append(still)
    assert psnr(*shown) < 45


def test_times_are_those_of_the_passes_in_their_order(live, settings):
    for number in range(2):
        milliseconds = live.frame(settings, number).milliseconds
        passes = ["region", "detail", "splat", "fill", "trace", "fovea", "blend"]
        passes += waits()
        assert list(milliseconds) == [*passes, "total"]
        assert sum(milliseconds[name] for name in passes) == pytest.approx(milliseconds["total"])


def test_a_frame_is_refined_in_its_disc_only(live, settings):
    first = live.frame(settings, 0)
    better = live.refined(first, 3, 1, quick=True)
    assert (numbers(better.fovea.samples, "count") == 4).all()
    np.testing.assert_array_equal(better.periphery, first.periphery)
    changed = (better.composite != first.composite).any(axis=2)
    assert changed.any()
    assert not (changed & (first.region.weight_image() == 0)).any()
    assert list(better.milliseconds) == ["trace", "fovea", "blend", *waits(), "total"]
    weight = first.weight_image()[..., None]
    expected = weight * better.of_disc(better.fovea.radiance) + (1 - weight) * live.splats(settings)
    np.testing.assert_allclose(better.composite, expected, atol=1e-5)


def test_only_a_patient_frame_waits_for_the_better_denoiser(live, settings, denoisers):
    frame = live.frame(replace(settings, spp=8))
    assert set(denoisers) == {"smooth"}
    live.refined(frame, 8, 1, quick=True)
    assert set(denoisers) == {"smooth"}
    denoisers.clear()
    live.refined(frame, 8, 2, quick=False)
    assert denoisers == ["denoise", "smooth"]


def test_samples_are_spread_evenly_which_takes_no_time(live, settings):
    frame = live.frame(replace(settings, spp=8))
    assert (numbers(frame.fovea.samples, "count") == 8).all()


def test_a_raw_fovea_reuses_samples_too(live, settings):
    raw = replace(settings, fovea="raw")
    live.frame(raw, 0)
    frame = live.frame(raw, 1)
    assert (numbers(frame.fovea.samples, "count") == 2).all()
    assert frame.fovea.radiance is frame.fovea.samples.radiance


def test_a_denoised_fovea_reuses_samples_and_is_refined_too(live, settings):
    denoised = replace(settings, fovea="denoised")
    frames = [live.frame(denoised, number) for number in range(3)]
    frames.append(live.refined(frames[-1], 1, 3, quick=False))
    for number, frame in enumerate(frames, 1):
        assert (numbers(frame.fovea.samples, "count") == number).all()
        assert frame.fovea.radiance is frame.fovea.denoised
        assert frame.underlay is None
        weight = frame.weight_image()[..., None]
        expected = weight * frame.of_disc(frame.fovea.denoised) + (1 - weight) * live.splats(settings)
        np.testing.assert_allclose(frame.composite, expected, atol=1e-5)
    # Less noisy than the samples, and as bright.
    shown, traced = host(frame.fovea.radiance), numbers(frame.fovea.samples, "radiance")
    steps = [np.median(np.abs(np.diff(image, axis=0))) for image in (shown, traced)]
    assert steps[0] < 0.7 * steps[1]
    assert np.median(shown) == pytest.approx(np.median(traced), rel=0.1)


def test_paths_end_early(scene, forest, monkeypatch):
    depths = []

    class Noting(renderer.Tracer):
        def __init__(self, scene, roulette_depth):
            depths.append(roulette_depth)
            super().__init__(scene, roulette_depth=roulette_depth)

    monkeypatch.setattr(renderer, "Tracer", Noting)
    LiveRenderer(scene, forest)
    renderer.Renderer(scene, forest)
    # None is what the scene says.
    assert depths == [1, None]


def test_a_forest_of_another_scene_is_refused(forest):
    with pytest.raises(UserError, match="this forest belongs to scene"):
        LiveRenderer(load_scene(small.furnace()), forest)
