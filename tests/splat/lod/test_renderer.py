"""A joined frame against a float64 twin that draws each picture on its own and joins them pixel by pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from compose.camera.camera import Camera, camera_from_pose
from splat.lod.joining import Picture
from splat.lod.pictures import ForestRenderer
from splat.model.building import build_forest
from splat.model.forest import Forest, forest_of, static_layer
from splat.model.gaussians import Gaussians
from splat.raster.projection import PIXEL_FILTER
from tests.splat.raster import reference
from tests.splat.samples import gaussians

WIDTH, HEIGHT = 150, 100
CORNERS = (-(-HEIGHT // 16) + 1, -(-WIDTH // 16) + 1)
CELLS = (CORNERS[0] - 1, CORNERS[1] - 1)


@pytest.fixture(scope="module")
def camera() -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, -4]
    return camera_from_pose(pose, WIDTH, HEIGHT, 120.0, 120.0, WIDTH / 2, HEIGHT / 2)


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
    # Not rounded, as the projection's limits follow from the frame's width.
    small = replace(
        camera,
        width=camera.width / size,
        height=camera.height / size,
        fx=camera.fx / size,
        fy=camera.fy / size,
        cx=camera.cx / size,
        cy=camera.cy / size,
    )
    g = forest.layers[layer - 1].gaussians
    double = Gaussians(**{name: tensor.double() for name, tensor in g.tensors()})
    splats = reference.project(double, small, variance / size**2)
    return reference.blend(splats, -(-camera.width // size), -(-camera.height // size)).numpy()


def twin(forest: Forest, camera: Camera, pictures: list[Picture], variances: list[float]) -> np.ndarray:
    """Samples, interpolated between them, times shares, pixel by pixel."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    total = np.zeros((HEIGHT, WIDTH, 3))
    for picture, variance in zip(pictures, variances, strict=True):
        samples = sampled(forest, camera, picture.layer, picture.rate, variance)
        size = 1 << picture.rate
        place = [y / size - 0.5, x / size - 0.5]
        share = lattice_at(picture.share, x, y)
        for channel in range(3):
            total[..., channel] += share * map_coordinates(
                samples[..., channel], place, order=1, mode="nearest"
            )
    return total


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
    "one layer at an eighth of the rate": [(1, 3, (1, 1))],
    "one layer at a sixteenth of the rate": [(1, 4, (1, 1))],
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
    np.testing.assert_allclose(frame.image(), expected, atol=1e-3)
    assert frame.nodes > 0


def test_two_panels_of_one_rate_and_one_of_another_meet_in_a_cell(arrays, forest, camera):
    """Cells are grouped by rates, whichever layers those are of: left 1 and 2, right 3 and 2."""
    left, right = np.maximum(ramp(1, -1), 0), np.maximum(ramp(-1, 1), 0)
    pictures = [Picture(1, 1, left), Picture(3, 1, right), Picture(2, 3, 1 - left - right)]
    frame = ForestRenderer(arrays, forest).render(camera, pictures, no_cutoff(), everything())
    expected = twin(forest, camera, pictures, filters(forest, camera, pictures, 0.5))
    np.testing.assert_allclose(frame.image(), expected, atol=1e-3)


def test_samples_of_a_layer_are_those_of_larger_pixels(arrays, forest, camera):
    image = ForestRenderer(arrays, forest).render_layer(camera, 1, 3).image()
    expected = sampled(forest, camera, 1, 3, PIXEL_FILTER * 64)
    assert image.shape == (13, 19, 3)
    np.testing.assert_allclose(image, expected, atol=1e-3)


def test_what_is_kept_of_a_camera_is_not_taken_for_another(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    other = replace(camera, cx=camera.cx + 7)
    first = [renderer.render_layer(c, n).image().copy() for c in (camera, other) for n in (3, 1)]
    again = [renderer.render_layer(c, n).image().copy() for c in (camera, other) for n in (3, 1)]
    fresh = [
        ForestRenderer(arrays, forest).render_layer(c, n).image() for c in (camera, other) for n in (3, 1)
    ]
    for images in zip(first, again, fresh, strict=True):
        assert np.array_equal(images[0], images[1])
        assert np.array_equal(images[0], images[2])
    assert not np.array_equal(first[0], first[2])


def test_a_wider_filter_than_before_reaches_nodes_outside_the_frame(arrays, forest, camera):
    """Kept footprints serve filters up to some width; a wider one asks for more of them."""
    renderer = ForestRenderer(arrays, forest)
    picture = Picture(3, 0, ramp(1, 1))
    renderer.render(camera, [picture], no_cutoff(), everything())
    wide = np.full(CORNERS, 0.01, np.float32)
    kept = renderer.render(camera, [picture], wide, everything())
    fresh = ForestRenderer(arrays, forest).render(camera, [picture], wide, everything())
    assert kept.nodes == fresh.nodes
    assert np.array_equal(kept.image(), fresh.image())


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
