"""Level, rate and cut-off over a frame, and values between the corners of its cells."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import CELL, DetailMap, LayerRange, at_corners, corner_positions, detail_map
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import Gaze

DESKTOP = DISPLAYS["desktop"]
RATES = (3, 2, 1, 0)
# Of the desktop's lattice.
CORNERS = (69, 121)


def desktop(
    acuity_model: str = "fov-gs",
    gaze: Gaze = Gaze(),  # noqa: B008
    layers: int = 4,
    lowest: int = 1,
    saliency: np.ndarray | None = None,
) -> DetailMap:
    """The detail of a full frame with fov-b 20 %."""
    rates = RATES[-layers:] if acuity_model != "none" else (0,) * layers
    drawn = LayerRange(0.25, rates, lowest)
    return detail_map(DESKTOP, gaze, 1920, 1080, ACUITY_MODELS[acuity_model], 20.0, drawn, saliency)


@pytest.mark.parametrize("acuity_model", ACUITY_MODELS)
@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0.2, 0.2), Gaze(0, 0), Gaze(-0.3, 2)])
@pytest.mark.parametrize("layers", [1, 2, 4])
def test_all_weights_sum_to_one(acuity_model, gaze, layers):
    found = desktop(acuity_model, gaze, layers)
    weights = [found.weight(index) for index in range(len(found.steps))]
    np.testing.assert_allclose(np.sum(weights, axis=0), 1, atol=1e-5)
    assert min(weight.min() for weight in weights) >= 0


def test_the_map_describes_its_frame():
    found = desktop(layers=2)
    assert (found.width, found.height, found.layers) == (1920, 1080, 2)
    for lattice in (found.eccentricity, found.cutoff, found.step_index, found.drawn_level, found.drawn_rate):
        assert lattice.shape == CORNERS
        assert lattice.dtype == np.float32


def test_without_a_cutoff_only_the_finest_layer_is_drawn_at_full_rate():
    found = desktop("none")
    assert (found.steps[0].layer, found.steps[0].rate) == (4, 0)
    assert (found.weight(0) == 1).all()
    assert (found.cutoff == 0.5).all()


def test_eccentricity_and_cutoff_by_hand():
    """90 degrees across and 1920 pixels: the eye is 960 pixels away.

    The middle of the left edge is seen at 45 degrees, where there are pi / 180 * sqrt(960^2 + 960^2) = 23.695
    pixels per degree across the line of sight; 1 / a(45) = 0.98928 cycles per degree.
    """
    display = Display(1920, 1088, 90.0)
    model = ACUITY_MODELS["fov-gs"]
    found = detail_map(display, Gaze(), 1920, 1088, model, 20.0, LayerRange(0.25, RATES))
    assert found.eccentricity[34, 0] == pytest.approx(45, abs=1e-4)
    assert found.eccentricity[34, 60] == pytest.approx(0, abs=1e-4)
    assert found.cutoff[34, 0] == pytest.approx(0.98928 / 23.695, rel=1e-4)
    # The corner: arctan(sqrt(960^2 + 544^2) / 960) degrees.
    assert found.eccentricity[0, 0] == pytest.approx(48.976, abs=1e-3)


def test_the_full_quality_region_counts_as_its_edge():
    """fov-b 20 % of 1080 pixels: arctan(216 / 1844.2) = 6.680 degrees, where 1 / a = 5.9591.

    In the middle there are 32.188 pixels per degree, and no more than half a cycle fits into a pixel.
    """
    found = desktop("fov-gs")
    assert found.cutoff[34, 60] == pytest.approx(5.9591 / 32.188, rel=1e-3)
    inside = found.eccentricity < 6.5
    assert inside.sum() > 300
    np.testing.assert_allclose(found.cutoff[inside], found.cutoff[34, 60], rtol=0.02)
    assert (found.step_index[inside] < found.step_index[0, 0]).all()


@pytest.mark.parametrize(
    ("gaze", "corner", "edge"),
    [
        # Gazes 768 and 432 pixels off the centre. The nearest edge is the one 216 pixels further out, as
        # arctan(984 / 1844.2) - arctan(768 / 1844.2) and arctan(648 / 1844.2) - arctan(432 / 1844.2).
        (Gaze(0.9, 0.5), (34, 108), 5.475),
        (Gaze(0.1, 0.5), (34, 12), 5.475),
        (Gaze(0.5, 0.9), (61, 60), 6.176),
        (Gaze(0.5, 0.1), (7, 60), 6.176),
    ],
)
def test_off_the_centre_the_edge_of_full_quality_is_the_nearest_in_degrees(gaze, corner, edge):
    """Between the gaze and that edge, 1 / a(edge) applies, at the corner's pixels per degree."""
    found = desktop("fov-gs", gaze)
    x, y = corner[1] * 16 - 960, corner[0] * 16 - 540
    per_degree = np.pi / 180 * np.sqrt(1844.16**2 + x**2 + y**2)
    assert found.cutoff[corner] == pytest.approx(1 / (1 / 48 + 0.022 * edge) / per_degree, rel=5e-4)


def test_without_a_full_quality_region_detail_falls_from_the_gaze_on():
    found = detail_map(
        DESKTOP, Gaze(0.3, 0.4), 1920, 1080, ACUITY_MODELS["fov-gs"], 0.0, LayerRange(0.25, RATES)
    )
    assert np.isfinite(found.cutoff).all()
    assert np.isfinite(found.step_index).all()
    assert found.cutoff.max() == 0.5


@pytest.mark.parametrize("row", [7, 13, 17, 18, 23])
def test_the_gaze_itself_has_eccentricity_0(row):
    """Here the dot product of its ray with itself is rounded to more than 1."""
    found = desktop(gaze=Gaze(0, row * 16 / 1080))
    assert np.isfinite(found.eccentricity).all()
    assert found.eccentricity[row, 0] == pytest.approx(0, abs=1e-5)


def test_detail_falls_with_eccentricity():
    found = desktop("fov-gs")
    order = np.argsort(found.eccentricity.ravel())
    # Pixels subtend smaller angles towards the edge of a flat display, so the order is not strict.
    for lattice in (found.drawn_level, -found.drawn_rate, found.cutoff):
        along = lattice.ravel()[order]
        assert (np.maximum.accumulate(along[::-1])[::-1] - along).max() < 0.35
    assert found.drawn_level.max() <= 4
    assert found.drawn_level.min() >= 1
    assert found.drawn_level[0, 0] < found.drawn_level[34, 60]
    assert found.drawn_rate[0, 0] > found.drawn_rate[34, 60]


def test_the_boundary_of_a_level_is_where_fov_gs_has_it():
    """fov-b 20 % of 1080 px on the desktop is 6.68 degrees; the next level begins where a(e) = 2 a(6.68)."""
    found = desktop("fov-gs")
    edge = np.degrees(np.arctan(216 / DESKTOP.focal))
    twice = (2 * (1 / 48 + 0.022 * edge) - 1 / 48) / 0.022
    row, column = np.unravel_index(np.abs(found.eccentricity - twice).argmin(), found.cutoff.shape)
    # Levels count in cycles per pixel: towards the edges there are more pixels to a degree. At the boundary
    # of a level, where the next one begins, the fade into it is just over.
    assert found.drawn_level[row, column] == pytest.approx(2, abs=0.3)
    closer = np.abs(found.eccentricity - 0.75 * twice).argmin()
    assert found.drawn_level.flat[closer] == 3


@pytest.mark.parametrize(
    ("acuity_model", "octaves"),
    [
        # log2(32.188 / 5.9591) less a fade of 0.22 octaves.
        ("fov-gs", 2.2133),
        # Layer 4 is faithful up to half of 0.25 cycles per pixel: 3 octaves, less a fade of a quarter.
        ("geisler-perry", 2.75),
    ],
)
def test_where_the_second_layer_begins(acuity_model, octaves):
    second = next(step for step in desktop(acuity_model).steps if step.layer == 3)
    assert second.octaves == pytest.approx(octaves, abs=1e-3)


@pytest.mark.parametrize(
    ("acuity_model", "fade", "number"), [("fov-gs", 0.22, 2), ("geisler-perry", 0.25, 1)]
)
def test_a_step_fades_in_over_its_fraction_of_an_octave(acuity_model, fade, number):
    found = desktop(acuity_model)
    octaves = -np.log2(found.cutoff)
    begins = found.steps[number].octaves
    fading = (octaves > begins + 0.01) & (octaves < begins + fade - 0.01)
    assert fading.sum() > 50
    expected = number - 1 + (octaves[fading] - begins) / fade
    np.testing.assert_allclose(found.step_index[fading], expected, atol=1e-3)


def test_no_layer_below_the_lowest_one():
    found = desktop("fov-gs", lowest=3)
    assert found.drawn_level.min() >= 3
    assert {step.layer for step in found.steps} == {3, 4}


def test_a_small_movement_of_the_gaze_changes_weights_a_little():
    """0.1 degree on the desktop is 3.2 pixels; no weight changes by more than a tenth."""
    before, after = (desktop("fov-gs", Gaze(0.4 + step / 1920, 0.5)) for step in (0, 3.2))
    assert [(s.layer, s.rate) for s in before.steps] == [(s.layer, s.rate) for s in after.steps]
    for index in range(len(before.steps)):
        assert np.abs(before.weight(index) - after.weight(index)).max() < 0.1


def test_rates_do_not_change_with_the_gaze():
    """A boundary of rates moves, but a whole layer never changes its rate at once, whatever the gaze."""
    found = {
        tuple((s.layer, s.rate) for s in desktop(acuity_model, Gaze(x, 0.5)).steps)
        for acuity_model in ("fov-gs", "stelacsf")
        for x in np.linspace(-0.2, 1.2, 57)
    }
    assert len(found) == 2


def test_saliency_does_not_change_the_level_under_fov_gs():
    """Fov-GS's level follows eccentricity (Eq. 7); saliency sharpens its filter (Eq. 9)."""
    salient = np.ones(CORNERS, np.float32)
    for acuity_model in ("fov-gs", "stelacsf", "geisler-perry"):
        plain, sharpened = desktop(acuity_model), desktop(acuity_model, saliency=salient)
        same = np.array_equal(plain.step_index, sharpened.step_index)
        assert same == (acuity_model == "fov-gs")
        assert (sharpened.step_index <= plain.step_index).all()


def test_saliency_raises_the_cutoff_by_up_to_two_fifths_where_it_is_high():
    plain = desktop("fov-gs")
    salient = np.zeros(CORNERS, np.float32)
    salient[:, 70:90], salient[:, 90:] = 0.5, 1
    drawn = desktop("fov-gs", saliency=salient)
    right, middle, left = np.s_[:, -10:], np.s_[:, 70:90], np.s_[:, :60]
    np.testing.assert_allclose(drawn.cutoff[right], np.minimum(plain.cutoff[right] * 1.4, 0.5), rtol=1e-5)
    np.testing.assert_allclose(drawn.cutoff[middle], np.minimum(plain.cutoff[middle] * 1.2, 0.5), rtol=1e-5)
    np.testing.assert_allclose(drawn.cutoff[left], plain.cutoff[left], rtol=1e-6)


def test_the_weights_blend_neighbouring_steps_into_level_and_rate():
    found = desktop("fov-gs")
    weights = [found.weight(index) for index in range(len(found.steps))]
    level = sum(w * step.layer for w, step in zip(weights, found.steps, strict=True))
    rate = sum(w * step.rate for w, step in zip(weights, found.steps, strict=True))
    np.testing.assert_allclose(found.drawn_level, level, atol=1e-4)
    np.testing.assert_allclose(found.drawn_rate, rate, atol=1e-4)


def test_a_lattice_becomes_an_image_of_the_frame():
    found = desktop()
    image = found.per_pixel(found.eccentricity)
    assert image.shape == (1080, 1920)
    # The gaze lies in the middle, between four pixels.
    assert image[539:541, 959:961].max() < 0.4
    assert image[0, 0] == pytest.approx(found.eccentricity[0, 0], abs=0.1)


def per_pixel(lattice: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) values of a map's lattice at the pixels of its frame."""
    return DetailMap(width, height, 1, lattice, lattice, lattice, (), lattice).per_pixel(lattice)


def test_corners_enclose_the_frame():
    """40 x 17 pixels take 3 x 2 cells of 16 pixels."""
    x, y = corner_positions(40, 17)
    assert CELL == 16
    assert x.tolist() == [[0, 16, 32, 48]] * 3
    assert y.T.tolist() == [[0, 16, 32]] * 4


def test_a_coarse_image_at_the_corners_of_cells():
    """64 x 32 pixels in two halves: linear between the centres at x = 16 and 48, constant beyond them."""
    image = np.array([[0.0, 1.0]], np.float32)
    np.testing.assert_allclose(at_corners(image, 64, 32), np.tile([0, 0, 0.5, 1, 1], (3, 1)), atol=1e-6)
    turned = at_corners(np.ascontiguousarray(image.T), 32, 64)
    np.testing.assert_allclose(turned, np.tile([0, 0, 0.5, 1, 1], (3, 1)).T, atol=1e-6)


def test_a_plane_is_interpolated_exactly():
    x, y = corner_positions(40, 17)
    lattice = (2 * x - 3 * y + 1).astype(np.float32)
    found = per_pixel(lattice, 40, 17)
    row, column = np.mgrid[0:17, 0:40] + 0.5
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 2 * column - 3 * row + 1, atol=1e-4)


def test_interpolation_uses_the_four_corners_of_a_cell_only():
    lattice = np.zeros((3, 4), np.float32)
    lattice[1, 2] = 1
    found = per_pixel(lattice, 40, 17)
    # The peak lies at (32, 16); the nearest pixel centres are half a pixel away along both axes.
    np.testing.assert_allclose(found[15:17, 31:33], (31 / 32) ** 2, rtol=1e-6)
    assert (found[:, :16] == 0).all()
    assert found[8, 24] > 0
