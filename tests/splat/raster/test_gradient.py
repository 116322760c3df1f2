"""The gradient of blending against the float64 twin's, and against finite differences."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
import torch

from splat.raster import blending
from splat.raster.blocks import CHANNELS
from splat.raster.tiles import TileGrid
from tests.splat.raster.splats import (
    NAMES,
    bin_splats,
    blended,
    doubles,
    random_splats,
    rasterize_backward,
    rasterized,
    round_splats,
    uploaded,
)

WIDTH, HEIGHT = 60, 50
DIFFERENTIABLE = NAMES[:-1]


def weights(grid: TileGrid) -> np.ndarray:
    """(padded H, padded W, 4) derivative of a loss by the image; smooth, 0 beyond the frame."""
    y, x = np.mgrid[: grid.padded_height, : grid.padded_width]
    planes = [np.sin(x / 9), np.cos(y / 7), np.sin((x + y) / 11), 0 * x]
    weight = np.stack(planes, axis=-1).astype(np.float32)
    weight[HEIGHT:] = weight[:, WIDTH:] = 0
    return weight


def gradients(arrays, splats, grid: TileGrid, weight: np.ndarray) -> dict[str, np.ndarray]:
    bins = bin_splats(arrays, splats, grid)
    (image,) = rasterized(arrays, splats, bins)
    flow = arrays.plain.Float(weight.ravel())
    found = rasterize_backward(arrays, splats, bins, image, flow)
    return {name: row.numpy() for name, row in zip(DIFFERENTIABLE, found, strict=True)}


def expected_gradients(splats, weight: np.ndarray) -> dict[str, np.ndarray]:
    leaves = {name: torch.from_numpy(row).requires_grad_() for name, row in doubles(splats).items()}
    image = blended(leaves, WIDTH, HEIGHT)
    (image * torch.from_numpy(weight[:HEIGHT, :WIDTH, :3]).double()).sum().backward()
    return {name: leaves[name].grad.numpy() for name in DIFFERENTIABLE}


@pytest.mark.parametrize("side", [8, 16])
def test_gradients_equal_the_twins(arrays, side):
    grid = TileGrid(WIDTH, HEIGHT, side)
    splats = random_splats(arrays, 150, WIDTH, HEIGHT)
    weight = weights(grid)
    found, expected = gradients(arrays, splats, grid, weight), expected_gradients(splats, weight)
    for name in DIFFERENTIABLE:
        scale = np.abs(expected[name]).max()
        assert scale > 0
        # Relative to the largest of its kind; worst seen 3e-4.
        np.testing.assert_allclose(found[name], expected[name], atol=2e-3 * scale, err_msg=name)


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_gradients_equal_finite_differences(arrays, name):
    """Two overlapping splats, under a weight that is 0 where they are cut off at 1/255.

    The cut moves with a splat, which the gradient leaves out.
    """
    rows = [(25.0, 24.0, 6.0, 0.7, 0.5, 1.0, 0.2, 1.0), (31.0, 27.0, 5.0, 0.6, 1.0, 0.3, 0.8, 2.0)]
    grid = TileGrid(WIDTH, HEIGHT)
    splats, weight = round_splats(arrays, rows), weights(grid)
    y, x = np.mgrid[: grid.padded_height, : grid.padded_width]
    weight[np.hypot(x - 28, y - 25) > 10] = 0
    found = gradients(arrays, splats, grid, weight)[name]
    values = doubles(splats)
    for k in range(2):
        step = {"x_precision": 1e-3, "y_precision": 1e-3}.get(name, 0.02)
        losses = []
        for sign in (-1, 1):
            moved = {n: row.copy() for n, row in values.items()}
            moved[name][k] += sign * step
            (image,) = rasterized(
                arrays, s := uploaded(arrays, list(moved.values())), bin_splats(arrays, s, grid)
            )
            losses.append((image.numpy().astype(np.float64) * weight.ravel()).sum())
        assert found[k] == pytest.approx((losses[1] - losses[0]) / (2 * step), rel=5e-3, abs=5e-3)


def test_a_clamped_alpha_has_a_gradient_by_colour_only(arrays):
    """Opacity 1 over a single pixel centre: alpha is 0.99, which nothing but the colour moves."""
    splats = round_splats(arrays, [(10.5, 10.5, 0.2, 1.0, 0.3, 0.4, 0.5, 1.0)])
    grid = TileGrid(WIDTH, HEIGHT)
    weight = np.zeros((grid.padded_height, grid.padded_width, CHANNELS), np.float32)
    weight[10, 10] = [1, 2, 3, 0]
    found = gradients(arrays, splats, grid, weight)
    for name in ("x", "y", "x_precision", "shear", "y_precision", "opacity"):
        assert found[name][0] == 0, name
    np.testing.assert_allclose(
        [found[c][0] for c in ("red", "green", "blue")], 0.99 * np.arange(1, 4), rtol=1e-5
    )


def test_the_derivative_by_opacity_of_the_image_is_ignored(arrays):
    splats = random_splats(arrays, 50, WIDTH, HEIGHT)
    grid = TileGrid(WIDTH, HEIGHT)
    weight = weights(grid)
    with_alpha = weight.copy()
    with_alpha[..., 3] = 1e6
    a, b = gradients(arrays, splats, grid, weight), gradients(arrays, splats, grid, with_alpha)
    for name in DIFFERENTIABLE:
        np.testing.assert_array_equal(a[name], b[name])


def test_invisible_splats_have_zero_gradients(arrays):
    """Transparent, beside the frame, and none visible at all."""
    seen = (20.0, 20.0, 3.0, 0.5, 1.0, 1.0, 1.0, 1.0)
    hidden = [(20.0, 20.0, 3.0, 0.0, 1.0, 1.0, 1.0, 1.0), (-90.0, 20.0, 3.0, 0.5, 1.0, 1.0, 1.0, 1.0)]
    grid = TileGrid(WIDTH, HEIGHT)
    some = gradients(arrays, round_splats(arrays, [*hidden, seen]), grid, weights(grid))
    none = gradients(arrays, round_splats(arrays, hidden), grid, weights(grid))
    for name in DIFFERENTIABLE:
        assert some[name][:2].tolist() == [0, 0]
        assert some[name][2] != 0
        assert none[name].tolist() == [0, 0]


def test_gradients_are_repeatable(arrays):
    splats = random_splats(arrays, 300, WIDTH, HEIGHT)
    grid = TileGrid(WIDTH, HEIGHT)
    runs = [gradients(arrays, splats, grid, weights(grid)) for _ in range(2)]
    for name in DIFFERENTIABLE:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])


def test_lanes_that_stay_together_give_the_same(arrays, monkeypatch):
    """As on a GPU: every lane visits all splats of its tile, and each sum is added by itself."""
    splats, grid = random_splats(arrays, 300, WIDTH, HEIGHT), TileGrid(WIDTH, HEIGHT)
    bins = bin_splats(arrays, splats, grid)
    (image,), flow = rasterized(arrays, splats, bins), arrays.plain.Float(weights(grid).ravel())
    rows = [rasterize_backward(arrays, splats, bins, image, flow)]
    monkeypatch.setattr(blending, "stays_together", lambda arrays: True)
    rows.append(rasterize_backward(arrays, splats, bins, image, flow))
    for name, one, other in zip(DIFFERENTIABLE, *rows, strict=True):
        scale = np.abs(other.numpy()).max()
        np.testing.assert_allclose(one.numpy(), other.numpy(), atol=1e-5 * scale, err_msg=name)


def test_all_lanes_of_a_vector_add_to_one_packet(arrays):
    """Dr.Jit does not promise it for its mode without conflicts; the sums of pairs rely on it."""
    if arrays.backend != "llvm":
        pytest.skip("packets are added to on the CPU alone")
    UInt, Float = arrays.plain.UInt, arrays.plain.Float
    lane = dr.arange(UInt, 64)
    rows, target = [Float(lane) + 100 * k for k in range(8)], dr.zeros(Float, 16 * 8)
    dr.scatter_reduce(
        dr.ReduceOp.Add, target, arrays.plain.ArrayXf(rows), lane // 4, mode=dr.ReduceMode.NoConflicts
    )
    expected = [[16 * group + 6 + 400 * k for k in range(8)] for group in range(16)]
    np.testing.assert_array_equal(target.numpy().reshape(16, 8), expected)
