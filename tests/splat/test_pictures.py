"""A joined frame against a float64 twin that draws each picture on its own and joins them pixel by pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from compose.view import Camera, from_camera_to_world
from splat.forest import Forest, build_forest, forest_of, static_layer
from splat.gaussians import Gaussians
from splat.joining import Picture
from splat.pictures import ForestRenderer
from splat.project import PIXEL_FILTER
from tests.splat import reference
from tests.splat.test_raster import gaussians

WIDTH, HEIGHT = 150, 100
CORNERS = (-(-HEIGHT // 16) + 1, -(-WIDTH // 16) + 1)
CELLS = (CORNERS[0] - 1, CORNERS[1] - 1)


@pytest.fixture(scope="module")
def camera() -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, -4]
    return from_camera_to_world(pose, WIDTH, HEIGHT, 120.0, 120.0, WIDTH / 2, HEIGHT / 2)


@pytest.fixture(scope="module")
def forest() -> Forest:
    return forest_of(build_forest(static_layer(gaussians("overlap", 80, 1)), 0.05, 3), 120.0, "", "")


def ramp(low: float, high: float) -> np.ndarray:
    """A lattice that rises from left to right."""
    return np.tile(np.linspace(low, high, CORNERS[1], dtype=np.float32), (CORNERS[0], 1))


def lattice_at(lattice: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return map_coordinates(lattice.astype(np.float64), [y / 16, x / 16], order=1, mode="nearest")


def sampled(forest: Forest, camera: Camera, layer: int, rate: int, variance: float) -> np.ndarray:
    """A layer at one sample per 2^rate x 2^rate pixels: the twin on a camera with larger pixels."""
    size = 1 << rate
    small = replace(
        camera,
        width=-(-camera.width // size),
        height=-(-camera.height // size),
        fx=camera.fx / size,
        fy=camera.fy / size,
        cx=camera.cx / size,
        cy=camera.cy / size,
    )
    g = forest.layers[layer - 1].gaussians
    double = Gaussians(**{name: tensor.double() for name, tensor in g.tensors()})
    return reference.render(double, small, variance / size**2).numpy()


def twin(forest: Forest, camera: Camera, pictures: list[Picture], variances: list[float]) -> np.ndarray:
    """Shares times samples, interpolated between samples, over the shares' sum."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    total = np.zeros((HEIGHT, WIDTH, 4))
    for picture, variance in zip(pictures, variances, strict=True):
        samples = sampled(forest, camera, picture.layer, picture.rate, variance)
        size = 1 << picture.rate
        at_x, at_y = np.meshgrid(
            (np.arange(samples.shape[1]) + 0.5) * size, (np.arange(samples.shape[0]) + 0.5) * size
        )
        share = lattice_at(picture.share, at_x, at_y)[..., None]
        four = np.concatenate([samples * share, share], axis=2)
        for channel in range(4):
            place = [y / size - 0.5, x / size - 0.5]
            total[..., channel] += map_coordinates(four[..., channel], place, order=1, mode="nearest")
    return total[..., :3] / total[..., 3:]


def everything() -> np.ndarray:
    return np.ones(CELLS, dtype=bool)


def no_cutoff() -> np.ndarray:
    return np.full(CORNERS, 0.5, dtype=np.float32)


def filters(forest: Forest, camera: Camera, pictures: list[Picture], cutoff: float) -> list[float]:
    """Fov-GS's Eq. 8, mended, for one cut-off everywhere."""
    blurs = [max(0.5 / cutoff, camera.fy / forest.focal_of(p.layer), 2.0**p.rate, 1.0) for p in pictures]
    return [PIXEL_FILTER * blur**2 for blur in blurs]


CASES = {
    "one layer at full rate": [(3, 0, (1, 1))],
    "one layer at half rate": [(2, 1, (1, 1))],
    "one layer at quarter rate": [(1, 2, (1, 1))],
    "two layers": [(3, 0, (0, 1)), (2, 0, (1, 0))],
    "two rates": [(3, 0, (0, 1)), (3, 1, (1, 0))],
    "two layers at two rates": [
        (3, 0, (0.2, 0.4)),
        (2, 0, (0.1, 0.3)),
        (3, 1, (0.3, 0.2)),
        (2, 2, (0.4, 0.1)),
    ],
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("cutoff", [0.5, 0.11])
def test_a_joined_frame_equals_its_twin(arrays, forest, camera, case, cutoff):
    pictures = [Picture(layer, rate, ramp(*ends)) for layer, rate, ends in CASES[case]]
    lattice = np.full(CORNERS, cutoff, dtype=np.float32)
    frame = ForestRenderer(arrays, forest).render(camera, pictures, lattice, everything())
    expected = twin(forest, camera, pictures, filters(forest, camera, pictures, cutoff))
    # Beyond the last whole sample a coarse picture's row reaches over the frame's border.
    inner = np.s_[4:-8, 4:-8]
    np.testing.assert_allclose(frame.image()[inner], expected[inner], atol=4e-3)
    assert frame.nodes > 0


def test_an_eighth_of_the_rate_joins_smoothly(arrays, forest, camera):
    """Its samples go through the grid of quarter rate; the picture stays that of the layer, blurred."""
    whole = ForestRenderer(arrays, forest).render_layer(camera, 1).image()
    picture = Picture(1, 3, ramp(1, 1))
    eighth = ForestRenderer(arrays, forest).render(camera, [picture], no_cutoff(), everything()).image()
    assert np.isfinite(eighth).all()
    blocks = lambda image: image[:96, :144].reshape(6, 16, 9, 16, 3).mean(axis=(1, 3))  # noqa: E731
    difference = np.abs(blocks(eighth) - blocks(whole))
    assert difference.mean() < 0.06 * blocks(whole).mean()


def test_a_layer_alone_is_the_rasterizers_picture(arrays, forest, camera):
    image = ForestRenderer(arrays, forest).render_layer(camera, 3).image()
    expected = sampled(forest, camera, 3, 0, PIXEL_FILTER)
    np.testing.assert_allclose(image, expected, atol=1e-3)


def test_at_the_displays_nyquist_frequency_the_filter_is_the_pixels_own(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    at_nyquist = renderer.render(camera, [Picture(3, 0, ramp(1, 1))], no_cutoff(), everything())
    assert np.array_equal(at_nyquist.image(), renderer.render_layer(camera, 3).image())


def test_what_is_not_wanted_is_black_and_costs_nothing(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    wanted = everything()
    wanted[:, 4:] = False
    pictures = [Picture(3, 0, ramp(0.5, 0.5)), Picture(2, 0, ramp(0.5, 0.5))]
    all_of_it = renderer.render(camera, pictures, no_cutoff(), everything())
    part = renderer.render(camera, pictures, no_cutoff(), wanted)
    np.testing.assert_array_equal(part.image()[:, :64], all_of_it.image()[:, :64])
    # The next column of cells is kept for samples that lie across the border.
    assert (part.image()[:, 96:] == 0).all()
    assert part.nodes < all_of_it.nodes
    nothing = renderer.render(camera, pictures, no_cutoff(), np.zeros(CELLS, dtype=bool))
    assert nothing.nodes == 0
    assert (nothing.image() == 0).all()


def test_a_layer_without_a_share_is_not_drawn(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    alone = renderer.render(camera, [Picture(3, 0, ramp(1, 1))], no_cutoff(), everything())
    beside = renderer.render(
        camera, [Picture(3, 0, ramp(1, 1)), Picture(1, 1, ramp(0, 0))], no_cutoff(), everything()
    )
    assert alone.nodes == beside.nodes
    assert np.array_equal(alone.image(), beside.image())


@pytest.mark.parametrize("extreme", ["huge", "tiny", "behind", "not a number"])
def test_extremes_stay_finite(arrays, camera, extreme):
    g = gaussians("overlap", 30, 0)
    if extreme == "huge":
        g.log_scales += 12
    if extreme == "tiny":
        g.log_scales -= 20
    if extreme == "behind":
        g.means[2] -= 100
    if extreme == "not a number":
        g.means[0, 3] = float("nan")
    forest = forest_of([static_layer(g)], 120.0, "", "")
    pictures = [Picture(1, 0, ramp(0, 1)), Picture(1, 2, ramp(1, 0))]
    lattice = np.full(CORNERS, 1e-4, dtype=np.float32)
    assert np.isfinite(
        ForestRenderer(arrays, forest).render(camera, pictures, lattice, everything()).image()
    ).all()


def test_the_same_frame_has_the_same_bits(arrays, forest, camera):
    pictures = [Picture(3, 0, ramp(0, 1)), Picture(2, 1, ramp(1, 0))]
    renderer = ForestRenderer(arrays, forest)
    first, second = (renderer.render(camera, pictures, no_cutoff(), everything()) for _ in range(2))
    assert torch.equal(torch.from_numpy(first.image().copy()), torch.from_numpy(second.image().copy()))
