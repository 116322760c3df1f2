"""Composited frames against a float64 twin that draws each layer image alone and sums them pixel by pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates

from compose.base.frozen import Frozen
from compose.camera.camera import Camera
from splat.lod import forest_renderer
from splat.lod.forest_renderer import ForestRenderer, finest_frequency
from splat.lod.layer_images import LayerImage, Under
from splat.model.forest import Forest, forest_of
from splat.model.trees import static_layer
from splat.raster.projection import PIXEL_FILTER
from splat.raster.tiles import TILE
from tests.splat.lod.views import (
    CELLS,
    CORNERS,
    HEIGHT,
    WIDTH,
    drawn,
    everything,
    frame_camera,
    no_cutoff,
    ramp,
    sampled,
    small_forest,
)
from tests.splat.samples import gaussians


@pytest.fixture(scope="module")
def camera() -> Camera:
    return frame_camera()


@pytest.fixture(scope="module")
def forest() -> Forest:
    return small_forest()


def lattice_at(lattice: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return map_coordinates(lattice.astype(np.float64), [y / 16, x / 16], order=1, mode="nearest")


def twin(forest: Forest, camera: Camera, images: list[LayerImage], variances: list[float]) -> np.ndarray:
    """Samples, interpolated linearly, times weights, pixel by pixel."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    total = np.zeros((HEIGHT, WIDTH, 3))
    for image, variance in zip(images, variances, strict=True):
        samples = sampled(forest, camera, image.layer, image.rate, variance)
        size = 1 << image.rate
        position = [y / size - 0.5, x / size - 0.5]
        weight = lattice_at(image.weight, x, y)
        for channel in range(3):
            total[..., channel] += weight * map_coordinates(
                samples[..., channel], position, order=1, mode="nearest"
            )
    return total


def filters(forest: Forest, camera: Camera, images: list[LayerImage], cutoff: float) -> list[float]:
    """Fov-GS's Eq. 8, corrected, for one cut-off everywhere."""
    blurs = [max(0.5 / cutoff, camera.fy / forest.focal_of(p.layer), 2.0**p.rate, 1.0) for p in images]
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
def test_a_composited_frame_equals_its_twin(arrays, forest, camera, case, cutoff):
    images = [LayerImage(layer, rate, ramp(*ends)) for layer, rate, ends in CASES[case]]
    lattice = np.full(CORNERS, cutoff, dtype=np.float32)
    frame = drawn(ForestRenderer(arrays, forest), camera, images, lattice, everything())
    expected = twin(forest, camera, images, filters(forest, camera, images, cutoff))
    np.testing.assert_allclose(frame.numpy(), expected, atol=1e-3)
    assert frame.nodes > 0


def test_cells_of_a_single_image_at_full_rate_are_drawn_in_place(arrays, forest, camera):
    """Left of the middle there is one image, and right of it two, or nothing that is wanted."""
    fine = np.clip(ramp(3, -2), 0, 1)
    images = [LayerImage(3, 0, fine), LayerImage(2, 1, 1 - fine)]
    expected = twin(forest, camera, images, filters(forest, camera, images, 0.5))
    renderer = ForestRenderer(arrays, forest)
    frame = drawn(renderer, camera, images, no_cutoff(), everything())
    np.testing.assert_allclose(frame.numpy(), expected, atol=1e-3)
    wanted = everything()
    wanted[:2] = False
    part = drawn(renderer, camera, images, no_cutoff(), wanted).numpy()
    assert (part[: 2 * TILE] == 0).all()
    np.testing.assert_allclose(part[2 * TILE :], expected[2 * TILE :], atol=1e-3)


def test_three_images_at_two_rates_meet_in_a_cell(arrays, forest, camera):
    """Cells are grouped by rates, whichever layers they show: left 1 and 2, right 3 and 2."""
    left, right = np.maximum(ramp(1, -1), 0), np.maximum(ramp(-1, 1), 0)
    images = [LayerImage(1, 1, left), LayerImage(3, 1, right), LayerImage(2, 3, 1 - left - right)]
    frame = drawn(ForestRenderer(arrays, forest), camera, images, no_cutoff(), everything())
    expected = twin(forest, camera, images, filters(forest, camera, images, 0.5))
    np.testing.assert_allclose(frame.numpy(), expected, atol=1e-3)


def test_the_cutoff_is_interpolated_at_each_gaussian(arrays, forest, camera):
    """The filter follows from the cut-off at a Gaussian's centre, clamped to the frame."""
    lattice = ramp(0.02, 0.5) * np.linspace(1, 0.4, CORNERS[0], dtype=np.float32)[:, None]
    frame = drawn(
        ForestRenderer(arrays, forest), camera, [LayerImage(3, 0, ramp(1, 1))], lattice, everything()
    )
    centre, _ = camera.project(forest.finest.means.T.double().numpy())
    cutoff = lattice_at(lattice, centre[:, 0], centre[:, 1])
    assert cutoff.min() < 0.05
    assert cutoff.max() > 0.2
    variance = PIXEL_FILTER * torch.from_numpy(np.maximum(0.5 / cutoff, 1)) ** 2
    # The worst are Gaussians centred beyond the last lattice point.
    np.testing.assert_allclose(frame.numpy(), sampled(forest, camera, 3, 0, variance), atol=3e-3)


def test_images_do_not_depend_on_each_other(arrays, camera):
    """Together they are the weighted sum of each alone, though one has a much wider filter.

    Small, opaque Gaussians around the frame reach into it under that filter alone.
    """
    g = gaussians("off-screen", 600, 0)
    g.log_scales -= 1.1
    g.opacity_logits += 4
    forest = forest_of([static_layer(g)], 120.0, "", "")
    rise = ramp(0, 1)
    render = lambda *images: (  # noqa: E731
        drawn(ForestRenderer(arrays, forest), camera, list(images), no_cutoff(), everything()).numpy()
    )
    fine, coarse = render(LayerImage(1, 0, ramp(1, 1))), render(LayerImage(1, 4, ramp(1, 1)))
    both = render(LayerImage(1, 0, 1 - rise), LayerImage(1, 4, rise))
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    weight = lattice_at(rise, x, y)[..., None]
    np.testing.assert_allclose(both, (1 - weight) * fine + weight * coarse, atol=1e-4)


def test_samples_of_a_layer_are_those_of_larger_pixels(arrays, forest, camera):
    image = ForestRenderer(arrays, forest).render_layer(camera, 1, 3).numpy()
    expected = sampled(forest, camera, 1, 3, PIXEL_FILTER * 64)
    assert image.shape == (13, 19, 3)
    np.testing.assert_allclose(image, expected, atol=1e-3)


def test_cached_footprints_belong_to_one_camera(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    other = replace(camera, cx=camera.cx + 7)
    first = [renderer.render_layer(c, n).numpy().copy() for c in (camera, other) for n in (3, 1)]
    again = [renderer.render_layer(c, n).numpy().copy() for c in (camera, other) for n in (3, 1)]
    fresh = [
        ForestRenderer(arrays, forest).render_layer(c, n).numpy() for c in (camera, other) for n in (3, 1)
    ]
    for images in zip(first, again, fresh, strict=True):
        assert np.array_equal(images[0], images[1])
        assert np.array_equal(images[0], images[2])
    assert not np.array_equal(first[0], first[2])


def test_a_wider_filter_than_before_reaches_nodes_outside_the_frame(arrays, forest, camera):
    """Cached footprints serve filters up to some width; a wider one needs more of them."""
    renderer = ForestRenderer(arrays, forest)
    image = LayerImage(3, 0, ramp(1, 1))
    drawn(renderer, camera, [image], no_cutoff(), everything())
    wide = np.full(CORNERS, 0.01, np.float32)
    kept = drawn(renderer, camera, [image], wide, everything())
    fresh = drawn(ForestRenderer(arrays, forest), camera, [image], wide, everything())
    assert kept.nodes == fresh.nodes
    assert np.array_equal(kept.numpy(), fresh.numpy())


def test_one_layer_is_the_rasterizers_image(arrays, forest, camera):
    image = ForestRenderer(arrays, forest).render_layer(camera, 3).numpy()
    expected = sampled(forest, camera, 3, 0, PIXEL_FILTER)
    np.testing.assert_allclose(image, expected, atol=1e-3)


def test_at_the_displays_nyquist_frequency_the_filter_is_the_pixels_own(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    at_nyquist = drawn(renderer, camera, [LayerImage(3, 0, ramp(1, 1))], no_cutoff(), everything())
    assert np.array_equal(at_nyquist.numpy(), renderer.render_layer(camera, 3).numpy())


@pytest.mark.parametrize(("rate", "cutoff"), [(0, 0.5), (0, 0.02), (2, 0.5), (3, 0.5)])
def test_wanted_cells_do_not_depend_on_the_others(arrays, camera, rate, cutoff):
    """Nodes outside of them are drawn as far as their filter and the interpolation of samples reach."""
    renderer = ForestRenderer(arrays, small_forest(400))
    images, lattice = [LayerImage(1, rate, ramp(1, 1))], np.full(CORNERS, cutoff, dtype=np.float32)
    wanted = np.zeros(CELLS, dtype=bool)
    wanted[2:4, 3:6] = True
    whole = drawn(renderer, camera, images, lattice, everything())
    part = drawn(renderer, camera, images, lattice, wanted)
    # Up to rounding: the image lies elsewhere in its atlas.
    np.testing.assert_allclose(part.numpy()[32:64, 48:96], whole.numpy()[32:64, 48:96], atol=1e-5)
    assert 0 < part.nodes <= whole.nodes


def test_unwanted_cells_are_black_and_cost_nothing(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    wanted = everything()
    wanted[:, 4:] = False
    images = [LayerImage(3, 0, ramp(0.5, 0.5)), LayerImage(2, 0, ramp(0.5, 0.5))]
    all_of_it = drawn(renderer, camera, images, no_cutoff(), everything())
    part = drawn(renderer, camera, images, no_cutoff(), wanted)
    np.testing.assert_array_equal(part.numpy()[:, :64], all_of_it.numpy()[:, :64])
    assert (part.numpy()[:, 64:] == 0).all()
    assert part.nodes < all_of_it.nodes
    nothing = drawn(renderer, camera, images, no_cutoff(), np.zeros(CELLS, dtype=bool))
    assert nothing.nodes == 0
    assert (nothing.numpy() == 0).all()


def test_an_image_without_a_weight_is_not_drawn(arrays, forest, camera):
    renderer = ForestRenderer(arrays, forest)
    alone = drawn(renderer, camera, [LayerImage(3, 0, ramp(1, 1))], no_cutoff(), everything())
    beside = drawn(
        renderer,
        camera,
        [LayerImage(3, 0, ramp(1, 1)), LayerImage(1, 1, ramp(0, 0))],
        no_cutoff(),
        everything(),
    )
    assert alone.nodes == beside.nodes
    assert np.array_equal(alone.numpy(), beside.numpy())


@pytest.mark.parametrize("extreme", ["huge", "tiny", "behind", "NaN"])
def test_extremes_stay_finite(arrays, camera, extreme):
    g = gaussians("overlap", 30, 0)
    if extreme == "huge":
        g.log_scales += 12
    if extreme == "tiny":
        g.log_scales -= 20
    if extreme == "behind":
        g.means[2] -= 100
    if extreme == "NaN":
        g.means[0, 3] = float("nan")
    forest = forest_of([static_layer(g)], 120.0, "", "")
    images = [LayerImage(1, 0, ramp(0, 1)), LayerImage(1, 2, ramp(1, 0))]
    lattice = np.full(CORNERS, 1e-4, dtype=np.float32)
    assert np.isfinite(
        drawn(ForestRenderer(arrays, forest), camera, images, lattice, everything()).numpy()
    ).all()


def test_the_same_frame_has_the_same_bits(arrays, forest, camera):
    images = [LayerImage(3, 0, ramp(0, 1)), LayerImage(2, 1, ramp(1, 0))]
    renderer = ForestRenderer(arrays, forest)
    first, second = (drawn(renderer, camera, images, no_cutoff(), everything()) for _ in range(2))
    assert np.array_equal(first.numpy(), second.numpy())


def test_nodes_are_counted_in_each_image(arrays, forest, camera):
    """Layers 3 and 1 together have as many as each alone."""
    renderer = ForestRenderer(arrays, forest)
    alone = [renderer.render_layer(camera, layer).nodes for layer in (3, 1)]
    images = [LayerImage(3, 0, ramp(0.5, 0.5)), LayerImage(1, 0, ramp(0.5, 0.5))]
    assert drawn(renderer, camera, images, no_cutoff(), everything()).nodes == sum(alone)
    assert 0 < alone[1] < alone[0] <= len(forest.finest)


def test_the_finest_frequency_is_half_a_cycle_per_training_pixel(forest, camera):
    """Layer 3 was trained at the camera's resolution, layer 1 at a quarter of it."""
    assert [finest_frequency(camera, forest, layer) for layer in (3, 2, 1)] == [0.5, 0.25, 0.125]
    assert finest_frequency(replace(camera, fy=240.0), forest, 3) == 0.25


def test_what_lies_under_a_frame_is_the_layer_alone(arrays, forest, camera):
    """Whatever the frame's cut-off, and without changing the frame."""
    renderer, images = (
        ForestRenderer(arrays, forest),
        [LayerImage(2, 0, ramp(1, 0)), LayerImage(1, 1, ramp(0, 1))],
    )
    lattice, wanted, cells = np.full(CORNERS, 0.1, np.float32), everything(), np.zeros(CELLS, dtype=bool)
    cells[1:3, 1:3] = True
    frame, under = renderer.render(camera, images, lattice, wanted, Under(3, cells))
    # Where an image lies among the others decides how positions are rounded.
    alike = lambda found, expected: np.testing.assert_allclose(found, expected, atol=1e-5)  # noqa: E731
    alike(frame.numpy(), drawn(renderer, camera, images, lattice, wanted).numpy())
    pixels = cells.repeat(TILE, axis=0).repeat(TILE, axis=1)[: camera.height, : camera.width]
    found, whole = under.numpy(), renderer.render_layer(camera, 3).numpy()
    alike(found[pixels], whole[pixels])
    assert (found[~pixels] == 0).all()
    for layer, covered in ((3, np.zeros_like(cells)), (3, cells)):
        nothing = renderer.render(camera, [], lattice, np.zeros_like(cells), Under(layer, covered))
        assert (nothing[0].numpy() == 0).all()
        alike(nothing[1].numpy(), found if covered.any() else 0)


def test_a_gaze_that_moves_replays_what_was_recorded(arrays, monkeypatch):
    """The numbers of nodes, pairs and rows change, but what is drawn needs few recordings."""
    recorded: list[int] = []

    def counted(*given):
        recorded.append(len(recorded))
        return forest_renderer.images_of_pairs(*given)

    monkeypatch.setattr(forest_renderer, "_images", Frozen(counted, by_size=True))
    renderer, camera = ForestRenderer(arrays, small_forest()), frame_camera()
    for step in range(12):
        fine = ramp(1, 0) * np.float32(1 - step / 24)
        images = [LayerImage(3, 0, fine), LayerImage(2, 1, 1 - fine)]
        wanted = everything()
        wanted[:, step // 2 : step // 2 + 2] = False
        frame = drawn(renderer, camera, images, no_cutoff(), wanted).numpy()
        assert frame.max() > 0
        np.testing.assert_array_equal(frame[:, 16 * (step // 2) : 16 * (step // 2 + 2)], 0)
    assert 0 < len(recorded) <= 4
