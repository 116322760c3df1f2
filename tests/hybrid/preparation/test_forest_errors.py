"""Quality on the held-out views, layer by layer, and what a forest learns of its own errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.image.colour import srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.forest_errors import held_out_quality, with_errors
from hybrid.preparation.training_views import read_frames
from hybrid.render.expected_errors import ExpectedErrors
from pathtrace.dataset.captured_frames import read_frame
from splat.io.forest_file import load_forest
from splat.lod.forest_renderer import ForestRenderer


def test_each_layer_is_measured_at_its_own_resolution(arrays, frames, trained):
    rows = held_out_quality(frames, trained)
    assert [row["layer"] for row in rows] == [1, 2]
    assert [row["nodes"] for row in rows] == list(trained.counts)
    # Few samples per pixel and few steps: rough, but an image of this scene and no other.
    assert min(row["psnr"] for row in rows) > 12
    assert all(0 < row["ssim"] <= 1 for row in rows)


def test_the_finest_layer_is_compared_with_the_captured_frames(arrays, frames, trained):
    entry = frames.held_out[0]
    shown = ForestRenderer(arrays, trained).render_layer(entry.camera, 2).numpy()
    clipped = (np.clip(image, 0, 1) for image in (shown, read_frame(entry.file).radiance))
    srgb = [np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) for x in clipped]
    expected = -10 * np.log10(np.mean((srgb[0] - srgb[1]) ** 2))
    assert held_out_quality(frames, trained)[-1]["psnr"] == pytest.approx(expected, abs=0.01)


def test_several_views_count_equally(frames, trained):
    views = frames.training[:2]
    alone = [held_out_quality(of_views(frames, [view]), trained)[0] for view in views]
    both = held_out_quality(of_views(frames, views), trained)[0]
    for metric in ("psnr", "ssim"):
        assert both[metric] == pytest.approx((alone[0][metric] + alone[1][metric]) / 2)


def test_without_held_out_views_there_is_no_quality(frames, trained):
    rows = held_out_quality(of_views(frames, []), trained)
    assert [{*row} for row in rows] == [{"layer", "nodes"}] * 2


def of_views(frames, views):
    """The frame set with these views held out."""
    return replace(frames, entries=[replace(view, held_out=True) for view in views])


@pytest.fixture(scope="module")
def darkened(made):
    """Frames, and a forest of them that is too dark on the left of the first frame."""
    frames, forest = read_frames(made / "frames"), load_forest(made / "box.forest")
    camera = frames.training[0].camera
    means = forest.nodes.gaussians.means.T.double().numpy()
    pixel, _ = camera.project(forest.place.in_world(means))
    sh = forest.nodes.gaussians.sh.clone()
    sh[0][:, pixel[:, 0] < 0.4 * camera.width] -= 1.0
    nodes = replace(forest.nodes, gaussians=replace(forest.nodes.gaussians, sh=sh))
    return frames, replace(forest, nodes=nodes, attached={})


def test_errors_are_expected_where_they_are(darkened):
    frames, forest = darkened
    arrays, entry = device_arrays(), frames.training[0]
    expected = ExpectedErrors(arrays, with_errors(frames, forest)).of(entry.camera)
    shown = ForestRenderer(arrays, forest).render_layer(entry.camera, len(forest.counts)).numpy()
    found = np.square(srgb_from_radiance(shown) - srgb_from_radiance(read_frame(entry.file).radiance)).mean(2)
    rows, columns = expected.shape
    cells = found[: rows * 16, : columns * 16]
    cells = np.array(
        [
            [cells[16 * i : 16 * i + 16, 16 * j : 16 * j + 16].mean() for j in range(columns)]
            for i in range(rows)
        ]
    )
    assert np.corrcoef(np.log(cells.ravel()), np.log(expected.ravel()))[0, 1] > 0.5
    assert 0.5 < expected.mean() / cells.mean() < 2


def test_training_attaches_them(made):
    forest = load_forest(made / "box.forest")
    assert ExpectedErrors(device_arrays(), forest).are_known
