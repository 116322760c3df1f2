"""Forests, layers, cut-offs and sampling rates at the ends of what may be asked for."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.lod.forest_renderer import ForestRenderer
from splat.lod.layer_images import LayerImage
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import Gaussians
from splat.model.trees import build_forest, static_layer
from splat.raster import parts
from splat.raster.differentiable import render_differentiable
from splat.raster.projection import PIXEL_FILTER
from tests.extremes import extreme
from tests.splat.lod.views import (
    CORNERS,
    drawn,
    everything,
    frame_camera,
    no_cutoff,
    ramp,
    sampled,
    small_forest,
)
from tests.splat.samples import gaussians

LAYERS = 12


def one_layer(g: Gaussians) -> Forest:
    # As it is, without the sorting along a curve that `forest_of` does.
    return Forest(static_layer(g), (len(g),), 120.0, "", "")


@pytest.fixture(scope="module")
def tall() -> Forest:
    """Twelve layers."""
    trees = build_forest(static_layer(gaussians("overlap", 80, 1)), 0.05, LAYERS)
    return forest_of(trees, 120.0, "", "")


@extreme("forest of no node", given="one layer without nodes", expected="a black frame")
def test_a_forest_of_no_node_is_black(each_arrays, got):
    empty = gaussians("overlap", 1, 0).select(torch.zeros(1, dtype=torch.bool))
    renderer = ForestRenderer(each_arrays, one_layer(empty))
    images = [LayerImage(1, 0, ramp(0, 1)), LayerImage(1, 2, ramp(1, 0))]
    frame = drawn(renderer, frame_camera(), images, no_cutoff(), everything())
    assert got(float(frame.numpy().max()), "g") == 0
    assert frame.numpy().shape == (100, 150, 3)
    # And so is the picture of no Gaussians that training asks for; its gradient has no elements.
    empty.means.requires_grad_()
    picture = render_differentiable(each_arrays, empty, frame_camera())
    picture.sum().backward()
    assert picture.abs().max() == 0
    assert empty.means.grad.shape == (3, 0)


@extreme("forest of one node", given="one layer of one node", expected="as in float64, within 1e-4")
def test_a_forest_of_one_node(each_arrays, got):
    forest, camera = one_layer(gaussians("overlap", 1, 0)), frame_camera()
    image = ForestRenderer(each_arrays, forest).render_layer(camera, 1).numpy()
    error = np.abs(image - sampled(forest, camera, 1, 0, PIXEL_FILTER)).max()
    assert image.max() > 0.1
    assert got(error, ".1e") < 1e-4


@extreme(
    "forest of a million nodes",
    given="150 x 100 pixels",
    expected="as without a forest, within 1e-3",
)
def test_a_forest_of_a_million_nodes(each_arrays, got):
    generator, n = torch.Generator().manual_seed(0), 1_000_000
    g = Gaussians(
        torch.randn(3, n, generator=generator),
        torch.full((3, n), -5.0),
        torch.tensor([[1.0], [0], [0], [0]]).expand(4, n).contiguous(),
        torch.zeros(n),
        torch.rand(1, 3, n, generator=generator),
    )
    frame = ForestRenderer(each_arrays, one_layer(g)).render_layer(frame_camera(), 1)
    with torch.no_grad():
        expected = render_differentiable(each_arrays, g, frame_camera()).numpy()
    assert frame.nodes > 500_000
    assert got(float(np.abs(frame.numpy() - expected).max()), ".1e") < 1e-3


@pytest.mark.parametrize(
    "layer",
    [
        pytest.param(
            layer,
            marks=extreme(
                f"layer {layer} of twelve", given="that layer alone", expected="as in float64, within 1e-3"
            ),
        )
        for layer in range(1, LAYERS + 1)
    ],
)
def test_each_of_twelve_layers_can_be_drawn(each_arrays, got, tall, layer):
    """Layer 1 was trained on pixels 2,048 times as wide, and is filtered accordingly."""
    camera = frame_camera()
    image = ForestRenderer(each_arrays, tall).render_layer(camera, layer).numpy()
    expected = sampled(tall, camera, layer, 0, PIXEL_FILTER * 4.0 ** (LAYERS - layer))
    assert image.max() > 0.01
    assert got(float(np.abs(image - expected).max()), ".1e") < 1e-3


@extreme(
    "77 layer images at once",
    given="one per corner of the cells, from twelve layers",
    expected="as twelve images whose weights are their sums, within 1e-4",
)
def test_many_layer_images_are_composited(each_arrays, got, tall):
    """A table of all combinations of that many would have 2^77 entries."""
    renderer, camera = ForestRenderer(each_arrays, tall), frame_camera()
    corners = np.eye(CORNERS[0] * CORNERS[1], dtype=np.float32).reshape(-1, *CORNERS)
    single = [LayerImage(1 + k % LAYERS, 0, weight) for k, weight in enumerate(corners)]
    joined = [LayerImage(1 + k, 0, corners[k::LAYERS].sum(axis=0)) for k in range(LAYERS)]
    first, second = (
        drawn(renderer, camera, images, no_cutoff(), everything()).numpy() for images in (single, joined)
    )
    assert second.mean() > 0.1
    assert got(float(np.abs(first - second).max()), ".1e") < 1e-4


@pytest.mark.parametrize("layer", [0, 13, -1])
def test_layers_that_do_not_exist_are_refused(each_arrays, tall, layer):
    renderer = ForestRenderer(each_arrays, tall)
    with pytest.raises(ValueError, match=f"layer {layer}: the forest has layers 1 to 12"):
        renderer.render_layer(frame_camera(), layer)


@pytest.mark.parametrize(
    "cutoff",
    [
        pytest.param(
            cutoff,
            marks=extreme(
                f"cut-off of {cutoff:g} cycles per pixel",
                given="one layer of three",
                expected="a haze below 0.05, the same for all such cut-offs",
            ),
        )
        for cutoff in (0.0, 1e-30, 1e-8)
    ],
)
def test_a_cutoff_of_nothing_leaves_a_haze(each_arrays, got, cutoff):
    """A Gaussian of opacity above 0.78 keeps half a percent, however wide its filter."""
    renderer, image = ForestRenderer(each_arrays, small_forest()), LayerImage(3, 0, ramp(1, 1))

    def draw(value: float) -> np.ndarray:
        lattice = np.full(CORNERS, value, np.float32)
        return drawn(renderer, frame_camera(), [image], lattice, everything()).numpy()

    frame = draw(cutoff)
    assert 0 < got(float(frame.max()), ".4f") < 0.05
    np.testing.assert_allclose(frame, draw(1e-7), atol=1e-6)


@extreme("cut-off of 1e10 cycles per pixel", given="one layer", expected="the pixel's own filter")
def test_a_cutoff_beyond_the_pixels_is_that_of_the_pixels(each_arrays, got):
    renderer, image = ForestRenderer(each_arrays, small_forest()), LayerImage(3, 0, ramp(1, 1))
    frame = drawn(renderer, frame_camera(), [image], np.full(CORNERS, 1e10, np.float32), everything())
    expected = renderer.render_layer(frame_camera(), 3).numpy()
    assert got(float(np.abs(frame.numpy() - expected).max()), "g") == 0


@pytest.mark.parametrize("cutoff", [float("nan"), -0.1])
def test_a_cutoff_that_is_none_is_refused(each_arrays, cutoff):
    renderer, lattice = ForestRenderer(each_arrays, small_forest()), no_cutoff()
    lattice[2, 3] = cutoff
    with pytest.raises(ValueError, match="cycles per pixel: must be 0 or more"):
        drawn(renderer, frame_camera(), [LayerImage(3, 0, ramp(1, 1))], lattice, everything())


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(
            size,
            marks=extreme(
                f"16 x 16 pixels per sample on {size[0]} x {size[1]}",
                given="one layer of three",
                expected="samples as in float64, within 1e-3, the frame between them",
            ),
        )
        for size in ((1, 1), (8, 8), (1, 4096), (4096, 1))
    ],
)
def test_frames_smaller_than_a_sample(each_arrays, got, size):
    forest, camera = small_forest(), frame_camera(*size)
    renderer = ForestRenderer(each_arrays, forest)
    samples = renderer.render_layer(camera, 3, 4).numpy()
    expected = sampled(forest, camera, 3, 4, PIXEL_FILTER * 4.0**4)
    assert samples.shape == (-(-size[1] // 16), -(-size[0] // 16), 3)
    assert got(float(np.abs(samples - expected).max()), ".1e") < 1e-3
    corners = (-(-size[1] // 16) + 1, -(-size[0] // 16) + 1)
    whole = np.ones((corners[0] - 1, corners[1] - 1), dtype=bool)
    lattice = np.full(corners, 0.5, np.float32)
    image = LayerImage(3, 4, np.ones(corners, np.float32))
    frame = drawn(renderer, camera, [image], lattice, whole).numpy()
    assert frame.shape == (size[1], size[0], 3)
    assert samples.min() - 1e-6 <= frame.min() <= frame.max() <= samples.max() + 1e-6


@pytest.mark.parametrize("value", [float("nan"), 1e38])
def test_one_bad_node_spoils_no_frame(each_arrays, value):
    """Radiance that is none is not drawn; too much of it saturates."""
    g = gaussians("overlap", 60, 1)
    g.sh[0, 1, 7] = value
    images = [LayerImage(1, 0, ramp(0, 1)), LayerImage(1, 2, ramp(1, 0))]
    frame = drawn(
        ForestRenderer(each_arrays, one_layer(g)), frame_camera(), images, no_cutoff(), everything()
    )
    assert np.isfinite(frame.numpy()).all()
    if np.isnan(value):
        others = g.select(torch.arange(60) != 7)
        without = drawn(
            ForestRenderer(each_arrays, one_layer(others)), frame_camera(), images, no_cutoff(), everything()
        )
        np.testing.assert_array_equal(frame.numpy(), without.numpy())


@extreme(
    "forest in parts",
    given="three layers at two rates, at most 200 pairs at once",
    expected="the bits of one pass",
)
def test_a_forest_is_drawn_in_parts(each_arrays, got, monkeypatch):
    images = [LayerImage(3, 0, ramp(0, 1)), LayerImage(2, 1, ramp(1, 0))]
    draw = lambda: (  # noqa: E731
        drawn(
            ForestRenderer(each_arrays, small_forest()), frame_camera(), images, no_cutoff(), everything()
        ).numpy()
    )
    whole = draw()
    monkeypatch.setattr(parts, "PAIRS_AT_ONCE", 200)
    assert got(float(np.abs(draw() - whole).max()), "g") == 0
