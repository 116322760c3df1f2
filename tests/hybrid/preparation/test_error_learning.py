"""What a forest learns of its own errors from the frames that it was trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.image.colour import srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.forest_errors import with_errors
from hybrid.preparation.training_views import read_frames
from hybrid.render.expected_errors import ExpectedErrors
from pathtrace.dataset.captured_frames import read_frame
from splat.io.forest_file import load_forest
from splat.lod.forest_renderer import ForestRenderer


@pytest.fixture(scope="module")
def trained(made):
    """Frames, and a forest of them that is too dark on the left of the first frame."""
    frames, forest = read_frames(made / "frames"), load_forest(made / "box.forest")
    camera = frames.training[0].camera
    means = forest.nodes.gaussians.means.T.double().numpy()
    pixel, _ = camera.project(forest.place.in_world(means))
    sh = forest.nodes.gaussians.sh.clone()
    sh[0][:, pixel[:, 0] < 0.4 * camera.width] -= 1.0
    nodes = replace(forest.nodes, gaussians=replace(forest.nodes.gaussians, sh=sh))
    return frames, replace(forest, nodes=nodes, attached={})


def test_errors_are_expected_where_they_are(trained):
    frames, forest = trained
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
