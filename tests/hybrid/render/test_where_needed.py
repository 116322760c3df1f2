"""Paths where the forest expects errors that the viewer sees, in the place of the disc."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import CELL, resolved_share
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze, eccentricity
from compose.fovea.foveation import FoveaMode, Placement
from compose.fusion.parents import TYPICAL_ERROR
from hybrid.render.expected_errors import ExpectedErrors
from hybrid.render.forest_attachments import attach_errors, errors_of
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from tests.extremes import extreme

SIZE = (96, 80)
SETTINGS = FrameSettings(fov_a=30, fov_b=20, paths="where-needed")


@pytest.fixture(scope="module")
def doubtful(forest):
    """The forest, which expects to be wrong on the left of what the camera sees."""
    means = forest.layers[0].gaussians.means
    return attach_errors(forest, torch.where(means[0] < means[0].median(), 0.02, 1e-6))


@pytest.fixture(scope="module")
def camera(scene):
    return scene.camera.resized(*SIZE)


@pytest.fixture(scope="module")
def renderer(scene, doubtful):
    return Renderer(scene, doubtful)


@pytest.mark.parametrize("mode", [FoveaMode.DENOISED, FoveaMode.FUSED])
def test_the_frame_is_path_traced_in_cells_of_great_error_only(renderer, camera, mode):
    settings = replace(SETTINGS, camera=camera, fovea=mode)
    frame = renderer.frame(settings)
    errors = renderer._errors.of(camera)
    traced = frame.region.weights > 0
    assert 0 < np.count_nonzero(traced) < traced.size
    assert errors[traced].min() > errors[~traced].max()
    weights = frame.weight_image()
    splats = renderer.frame(replace(settings, fov_a=0, fov_b=0)).composite
    np.testing.assert_allclose(frame.composite[weights == 0], splats[weights == 0], atol=1e-6)
    inside = weights == 1
    np.testing.assert_allclose(
        frame.composite[inside], frame.of_disc(frame.fovea.radiance)[inside], rtol=1e-6
    )
    assert np.abs(frame.composite[inside] - splats[inside]).mean() > 0.01


def test_as_many_paths_are_traced_as_in_the_disc(renderer, camera):
    for spp in (1, 2, 8):
        settings = replace(SETTINGS, camera=camera, spp=spp)
        disc, cells = (renderer.paths(replace(settings, paths=one)) for one in Placement)
        assert cells == pytest.approx(disc, abs=spp * max(4 // spp, 1) * CELL**2)
        assert renderer.frame(settings).fovea.samples.mean_count() == pytest.approx(max(spp, 4), rel=0.05)


def test_what_the_viewer_does_not_resolve_counts_less(renderer, scene, monkeypatch):
    width, height = 960, 800
    display, gaze, model = DISPLAYS["hmd"], Gaze(0.2, 0.7), ACUITY_MODELS["fovvideovdp"]
    share = resolved_share(display, gaze, width, height, model)
    # Across the line of sight, pixels in float64.
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    per_degree = np.radians(1) * np.sqrt(display.focal**2 + x**2 + y**2)
    cutoff = model.cutoff(eccentricity(display.viewer(width, height), gaze).astype(np.float64))
    twin = np.minimum(2 * cutoff / per_degree, 1) ** 2
    np.testing.assert_allclose(share, twin.reshape(50, CELL, 60, CELL).mean(axis=(1, 3)), atol=0.03)
    assert share.min() < 0.5 < share.max()
    # Where errors are the same everywhere, paths are traced where all of them is seen.
    monkeypatch.setattr(renderer._errors, "of", lambda camera: np.full(share.shape, 1e-3, np.float32))
    settings = replace(SETTINGS, gaze=gaze, display="hmd", fov_a=20, fov_b=10)
    region = renderer._errors.region(scene.camera.resized(width, height), settings)
    assert len(region.cells) == pytest.approx(np.pi * 160**2 / CELL**2, rel=0.05)
    assert share.ravel()[region.cells].min() > 0.99


def test_raw_foveas_and_frames_that_are_traced_as_a_whole_are_as_they_were(renderer, camera):
    for settings in (replace(SETTINGS, fovea=FoveaMode.RAW), replace(SETTINGS, fov_a=400, fov_b=400)):
        cells, disc = (
            renderer.frame(replace(settings, camera=camera, spp=4, paths=one)).composite
            for one in ("where-needed", "disc")
        )
        np.testing.assert_array_equal(cells, disc)


def test_a_radius_of_none_traces_none(renderer, camera):
    frame = renderer.frame(replace(SETTINGS, camera=camera, fov_a=0, fov_b=0))
    assert frame.fovea.disc.count == 0
    assert not frame.weight_image().any()


@extreme(
    "paths where needed, in frames of any shape",
    given="frames of 1 x 1, 300 x 2 and 17 x 33 pixels; fused, with a disc of 5 % to 90 %",
    expected="finite; no more pixels are traced than the disc has, or one cell",
)
@pytest.mark.parametrize("fov_a", [5, 90])
@pytest.mark.parametrize("size", [(1, 1), (300, 2), (17, 33)])
def test_cells_of_frames_of_any_shape(renderer, scene, size, fov_a, got):
    settings = replace(SETTINGS, camera=scene.camera.resized(*size), fov_a=fov_a, fov_b=1)
    frame = renderer.frame(settings)
    assert np.isfinite(frame.composite).all()
    traced = got(frame.fovea.disc.count)
    assert traced <= max(settings.foveation.region(*size).count + CELL**2 / 2, CELL**2)


@extreme(
    "a forest that expects no error",
    given="expected errors of 0 in all nodes",
    expected="no path is traced; the splats are shown",
)
def test_a_forest_that_expects_no_error_is_shown_alone(scene, forest, camera, got):
    sure = attach_errors(forest, torch.zeros(forest.counts[0]))
    frame = Renderer(scene, sure).frame(replace(SETTINGS, camera=camera, fill=False))
    assert got(frame.fovea.disc.count) == 0
    np.testing.assert_array_equal(frame.composite, frame.periphery)


def test_a_forest_that_does_not_know_traces_the_disc_and_says_so(scene, forest, camera, caplog):
    renderer, settings = Renderer(scene, forest), replace(SETTINGS, camera=camera)
    frame = renderer.frame(settings)
    np.testing.assert_array_equal(
        frame.composite, Renderer(scene, forest).frame(replace(settings, paths="disc")).composite
    )
    assert frame.settings.paths is Placement.DISC
    renderer.frame(settings)
    assert len([r for r in caplog.records if "does not say where it is wrong" in r.message]) == 1


def test_the_window_gathers_samples_in_the_cells(scene, doubtful, camera):
    live = LiveRenderer(scene, doubtful)
    settings = replace(SETTINGS, camera=camera, spp=1)
    counts = [live.frame(settings, seed).fovea.samples.mean_count() for seed in range(3)]
    assert counts == pytest.approx([4, 8, 12])
    refined = live.refined(live.frame(settings, 3), 1, 4, quick=True)
    assert refined.fovea.samples.mean_count() == pytest.approx(20)
    moved = replace(settings, camera=replace(camera, fx=camera.fx * 1.01))
    assert live.frame(moved, 5).fovea.samples.mean_count() > 4


def test_errors_are_stored_in_a_byte_each(forest):
    count = forest.counts[0]
    errors = torch.logspace(-9, 0, count)
    found = errors_of(attach_errors(forest, errors))
    np.testing.assert_allclose(found, errors, rtol=2 ** (1 / 16) - 1 + 1e-4)
    assert errors_of(attach_errors(forest, torch.zeros(count))).abs().max() == 0
    assert errors_of(forest) is None
    damaged = replace(forest, attached={"errors.coarsest": torch.zeros(count + 1, dtype=torch.uint8)})
    with pytest.raises(UserError, match="expected errors are damaged"):
        errors_of(damaged)


def test_the_typical_error_is_the_geometric_mean(forest, arrays, camera):
    camera = replace(camera, fy=forest.trained_focal)
    for finer in (camera, replace(camera, fy=4 * camera.fy)):
        assert ExpectedErrors(arrays, forest).typical_in(finer) == TYPICAL_ERROR
    known = attach_errors(forest, torch.logspace(-6, -2, forest.counts[0]))
    errors = ExpectedErrors(arrays, known)
    assert errors.typical_in(camera) == pytest.approx(1e-4, rel=0.05)
    # Finer frames show more of them, coarser ones no less.
    of_size = [errors.typical_in(replace(camera, fy=times * camera.fy)) for times in (0.5, 1, 2, 4)]
    np.testing.assert_allclose(np.array(of_size) / of_size[1], [1, 1, 2**1.75, 4**1.75])
    perfect = attach_errors(forest, torch.zeros(forest.counts[0]))
    assert 0 < ExpectedErrors(arrays, perfect).typical_in(camera) < 1e-8


def test_an_unknown_placement_is_refused():
    with pytest.raises(UserError, match="paths everywhere: must be disc or where-needed"):
        FrameSettings(paths="everywhere")
