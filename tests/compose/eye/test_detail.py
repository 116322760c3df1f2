"""Level, rate and cut-off over a frame; displays; saliency."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import COARSEST_RATE, DetailMap, at_corners, detail_map, steps_down
from compose.eye.display import DISPLAYS, Display, display_named
from compose.eye.gaze import Gaze, eccentricity
from compose.eye.saliency import saliency

DESKTOP = DISPLAYS["desktop"]
RATES = (3, 2, 1, 0)


def desktop(acuity_model: str = "fov-gs", gaze: Gaze = Gaze(), layers: int = 4, **others) -> DetailMap:  # noqa: B008
    rates = RATES[-layers:] if acuity_model != "none" else (0,) * layers
    return detail_map(DESKTOP, gaze, 1920, 1080, ACUITY_MODELS[acuity_model], 20.0, 0.25, rates, **others)


@pytest.mark.parametrize("acuity_model", ACUITY_MODELS)
@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0.2, 0.2), Gaze(0, 0), Gaze(-0.3, 2)])
@pytest.mark.parametrize("layers", [1, 2, 4])
def test_all_shares_sum_to_one(acuity_model, gaze, layers):
    found = desktop(acuity_model, gaze, layers)
    shares = [found.share(step) for step in range(len(found.steps))]
    np.testing.assert_allclose(np.sum(shares, axis=0), 1, atol=1e-5)
    assert min(share.min() for share in shares) >= 0


def test_without_a_law_only_the_finest_layer_is_drawn_at_full_rate():
    found = desktop("none")
    assert (found.steps[0].layer, found.steps[0].rate) == (4, 0)
    assert (found.share(0) == 1).all()
    assert (found.cutoff == 0.5).all()


def test_detail_falls_with_eccentricity():
    found = desktop("fov-gs")
    order = np.argsort(found.eccentricity.ravel())
    # Angles of pixels shrink towards the edge of a flat display, so the order is not strict.
    for lattice in (found.drawn_level, -found.drawn_rate, found.cutoff):
        along = lattice.ravel()[order]
        assert (np.maximum.accumulate(along[::-1])[::-1] - along).max() < 0.35
    assert found.drawn_level.max() <= 4
    assert found.drawn_level.min() >= 1


def test_the_boundary_of_a_level_is_where_the_law_has_it():
    """fov-b 20 % of 1080 px on the desktop is 6.68 degrees; the next level begins at a(e) = 2 a(6.68)."""
    found = desktop("fov-gs")
    edge = np.degrees(np.arctan(216 / DESKTOP.focal))
    twice = (2 * (1 / 48 + 0.022 * edge) - 1 / 48) / 0.022
    row, column = np.unravel_index(np.abs(found.eccentricity - twice).argmin(), found.cutoff.shape)
    # Levels count in cycles per pixel: towards the edges there are more pixels to a degree. At the boundary
    # of a level, where the next one begins, the fade into it is just over.
    assert found.drawn_level[row, column] == pytest.approx(2, abs=0.3)
    closer = np.abs(found.eccentricity - 0.75 * twice).argmin()
    assert found.drawn_level.flat[closer] == 3


def test_no_layer_below_the_lowest_one():
    found = desktop("fov-gs", lowest=3)
    assert found.drawn_level.min() >= 3
    assert {step.layer for step in found.steps} == {3, 4}


def test_a_small_step_of_the_gaze_changes_shares_a_little():
    """0.1 degree on the desktop is 3.2 pixels; no share changes by more than a tenth."""
    before, after = (desktop("fov-gs", Gaze(0.4 + step / 1920, 0.5)) for step in (0, 3.2))
    assert [(s.layer, s.rate) for s in before.steps] == [(s.layer, s.rate) for s in after.steps]
    for step in range(len(before.steps)):
        assert np.abs(before.share(step) - after.share(step)).max() < 0.1


def test_the_steps_of_fov_gs_on_paper():
    """Cut-off 0.25 at the edge; the layers' own pixels are 1, 2, 4 and 8 display pixels.

    Level boundaries lie at 0.25, 0.125 and 0.0625 cycles per pixel: 2, 3 and 4 octaves. There samples of
    2, 4 and 8 pixels carry what is left.
    """
    steps = steps_down(0.25, 0.25, (3, 2, 1, 0), 1, 0.22)
    assert [(step.layer, step.rate) for step in steps] == [(4, 0), (3, 1), (2, 2), (1, 3), (1, 4)]
    np.testing.assert_allclose([step.octaves + 0.22 for step in steps[1:4]], [2, 3, 4])
    assert steps[4].octaves == 5


def test_rates_do_not_change_with_the_gaze():
    """A boundary of rates moves; a whole layer never changes its rate at once, whatever the gaze."""
    found = {
        tuple((s.layer, s.rate) for s in desktop(acuity_model, Gaze(x, 0.5)).steps)
        for acuity_model in ("fov-gs", "stelacsf")
        for x in np.linspace(-0.2, 1.2, 57)
    }
    assert len(found) == 2


def test_a_forest_of_one_layer_still_loses_samples():
    steps = steps_down(0.25, 0.25, (0,), 1, 0.22)
    assert [(step.layer, step.rate) for step in steps] == [(1, rate) for rate in range(COARSEST_RATE + 1)]
    assert [step.octaves for step in steps[1:]] == [2, 3, 4, 5]


def test_what_is_salient_keeps_its_level_under_fov_gs_alone():
    """Fov-GS's level follows eccentricity (Eq. 7); attention sharpens its filter (Eq. 9)."""
    salient = np.ones((69, 121), np.float32)
    for acuity_model in ("fov-gs", "stelacsf", "geisler-perry"):
        same = np.array_equal(desktop(acuity_model).place, desktop(acuity_model, saliency=salient).place)
        assert same == (acuity_model == "fov-gs")


def test_saliency_keeps_more_where_it_is_high():
    plain = desktop("fov-gs")
    salient = np.zeros((69, 121), np.float32)
    salient[:, 90:] = 1
    drawn = desktop("fov-gs", saliency=salient)
    right, left = np.s_[:, -10:], np.s_[:, :60]
    np.testing.assert_allclose(drawn.cutoff[right], np.minimum(plain.cutoff[right] * 1.4, 0.5), rtol=1e-5)
    np.testing.assert_allclose(drawn.cutoff[left], plain.cutoff[left], rtol=1e-6)


def test_a_coarse_picture_at_the_corners_of_cells():
    """64 x 32 pixels in two halves: linear between the centres at x = 16 and 48, constant beyond them."""
    image = np.array([[0.0, 1.0]], np.float32)
    np.testing.assert_allclose(at_corners(image, 64, 32), np.tile([0, 0, 0.5, 1, 1], (3, 1)), atol=1e-6)


def test_pixels_per_degree_of_a_display():
    """1920 pixels over 55 degrees: the eye is 960 / tan 27.5 = 1844.2 pixels away."""
    assert DESKTOP.focal == pytest.approx(1844.2, abs=0.1)
    assert DESKTOP.pixels_per_degree == pytest.approx(32.19, abs=0.01)
    angle = eccentricity(DESKTOP.viewer(1920, 1080), Gaze())
    assert angle[540, 0] == pytest.approx(27.5, abs=0.03)


def test_the_corner_of_a_view_of_110_degrees():
    """Square, 110 degrees across: tan 55 = 1.4281 along both axes, arctan(1.4281 sqrt 2) = 63.66 degrees."""
    wide = Display(1000, 1000, 110.0).viewer(1000, 1000)
    assert eccentricity(wide, Gaze())[0, 0] == pytest.approx(63.66, abs=0.03)
    # From one corner to the opposite one, not twice a pixel distance but twice the angle.
    assert eccentricity(wide, Gaze(0, 0))[-1, -1] == pytest.approx(127.3, abs=0.1)


def test_a_display_comes_from_a_file(tmp_path):
    file = tmp_path / "d.json"
    file.write_text(json.dumps({"width": 256, "height": 256, "fov": 20}))
    assert display_named(str(file)).pixels_per_degree == pytest.approx(12.67, abs=0.01)
    assert display_named("hmd") is DISPLAYS["hmd"]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ('{"width": 256, "height": 256}', "pixels per degree"),
        ('{"width": 256, "height": 256, "fov": 0}', "fov is 0"),
        ('{"width": 256, "height": 256, "fov": 180}', "less than 180"),
        ('{"width": "wide", "height": 256, "fov": 20}', "width is wide"),
        ('{"width": 256, "height": 256, "fov": NaN}', "fov is nan"),
        ('{"width": 256, "height": 256, "fov": 20, "curved": true}', "does not know curved"),
        ("[1, 2]", "not an object"),
        ("{", "must be JSON"),
    ],
)
def test_a_display_without_sense_is_named(tmp_path, content, complaint):
    file = tmp_path / "d.json"
    file.write_text(content)
    with pytest.raises(UserError, match=complaint) as caught:
        display_named(str(file))
    assert "\n" not in str(caught.value)
    assert "d.json" in str(caught.value)


def test_a_display_that_is_not_there_is_named():
    with pytest.raises(UserError, match="--display wall: must be desktop, hmd or a JSON file"):
        display_named("wall")


def test_the_odd_one_out_is_salient_by_colour_alone():
    """Discs of one luminance, one of them of another colour."""
    picture = np.full((48, 64, 3), 0.3, np.float32)
    y, x = np.mgrid[0:48, 0:64]
    discs = [(12, 12), (12, 32), (12, 52), (36, 12), (36, 32), (36, 52)]
    for number, (cy, cx) in enumerate(discs):
        colour = [0.45, 0.3, 0.15] if number == 4 else [0.15, 0.3, 0.45]
        picture[np.hypot(y - cy, x - cx) < 4] = colour
    found = saliency(picture)
    assert found.min() == 0
    assert found.max() == 1
    at = [found[cy, cx] for cy, cx in discs]
    assert int(np.argmax(at)) == 4


def test_a_plain_picture_draws_no_attention():
    assert (saliency(np.full((10, 12, 3), 0.5, np.float32)) == 0).all()
