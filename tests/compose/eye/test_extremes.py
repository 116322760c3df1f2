"""Displays, gazes, acuity models and saliency at the ends of what users may ask for."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from compose.base.errors import MOST_SEED, UserError, require_seed
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import LayerRange, detail_map, saliency
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import FURTHEST, Gaze, eccentricity, simulated
from tests import small
from tests.extremes import extreme

LAYERS = LayerRange(0.5, (2, 1, 0, 0))


def display_of(pixels_per_degree: float) -> Display:
    """A display of 1920 pixels with so many pixels per degree at its centre."""
    return Display(1920, 1080, float(2 * np.degrees(np.arctan(960 / np.degrees(pixels_per_degree)))))


@pytest.mark.parametrize(
    "display",
    [
        pytest.param(
            display, marks=extreme(name, given=f"{given}, all acuity models", expected="finite detail")
        )
        for name, given, display in (
            ("one pixel per degree", "1920 pixels", display_of(1)),
            ("200 pixels per degree", "1920 pixels", display_of(200)),
            ("a display of one pixel", "55 degrees", Display(1, 1, 55.0)),
            ("a display of 1e9 pixels", "55 degrees", Display(10**9, 10**9, 55.0)),
            ("a display of nearly 180 degrees", "179.9999999999", Display(1920, 1080, 179.9999999999)),
            ("a display of 0.001 degrees", "1920 pixels", Display(1920, 1080, 0.001)),
        )
    ],
)
def test_any_display_has_detail(display, got):
    ends = []
    gazes = Gaze(), Gaze(0, 0), Gaze(1, 1), Gaze(-FURTHEST, FURTHEST)
    for gaze, fov_b, model in product(gazes, (0.0, 15.0, 1e6), ACUITY_MODELS.values()):
        detail = detail_map(display, gaze, 64, 48, model, fov_b, LAYERS)
        for lattice in (detail.eccentricity, detail.cutoff, detail.step_index, detail.drawn_level):
            assert np.isfinite(lattice).all()
        assert (detail.cutoff > 0).all()
        assert detail.cutoff.max() <= 0.5
        assert sum(detail.weight(n) for n in range(len(detail.steps))) == pytest.approx(1, abs=1e-5)
        ends += [float(detail.drawn_level.min()), float(detail.drawn_level.max())]
    assert 1 <= got(min(ends), ".3g") <= got(max(ends), ".3g") <= 4


def test_densities_are_as_asked():
    for density in (1, 200):
        assert display_of(density).pixels_per_degree == pytest.approx(density, rel=1e-9)


@pytest.mark.parametrize("fov", [0.0, 5e-324, 1e-45, 9e-4, 180.0, 1e308, np.inf, np.nan, -1.0])
def test_displays_that_nobody_has_are_refused(fov):
    with pytest.raises(UserError, match=r"^display fov "):
        Display(1920, 1080, fov)


@pytest.mark.parametrize(
    "angle",
    [
        pytest.param(
            a,
            marks=extreme(
                f"acuity at {a:g} degrees", given="each model", expected="above 0, no more than at 0"
            ),
        )
        for a in (0.0, 90.0, 180.0)
    ],
)
def test_acuity_at_its_ends(angle, got):
    for model in ACUITY_MODELS.values():
        assert 0 < got(float(model.cutoff(np.array(angle))), ".3g") <= float(model.cutoff(np.array(0.0)))


def test_eccentricities_of_a_gaze_far_outside_are_angles():
    angles = eccentricity(DISPLAYS["desktop"].viewer(64, 48), Gaze(FURTHEST, -FURTHEST))
    assert np.isfinite(angles).all()
    assert 85 < angles.min() <= angles.max() < 95


@pytest.mark.parametrize("x", [np.nan, np.inf, 1e308, FURTHEST + 1.0])
def test_gazes_that_cannot_be_shown_are_refused(x):
    for gaze in ((x, 0.5), (0.5, -x)):
        with pytest.raises(ValueError, match=r"^gaze "):
            Gaze(*gaze)


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(
            v, marks=extreme(f"saliency of a constant image of {v:g}", given="36x64", expected="0 everywhere")
        )
        for v in (0.0, 1e-8, 0.3, 1e6, 1e30)
    ],
)
def test_nothing_is_salient_in_a_constant_image(value, got):
    assert got(float(saliency(np.full((36, 64, 3), value, np.float32)).max())) == 0


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (64, 1), (2, 3)])
def test_saliency_of_tiny_images_is_in_its_range(size):
    found = saliency(small.rng().random((*size, 3)).astype(np.float32))
    assert found.shape == size
    assert np.isfinite(found).all()
    assert 0 <= found.min() <= found.max() <= 1


@pytest.mark.parametrize("size", [(1, 1), (1, 4096), (4096, 1)])
def test_a_viewer_looks_around_frames_of_any_shape(size):
    trace = simulated(DISPLAYS["desktop"], *size, 2.0, MOST_SEED)
    assert len(trace.gazes) == 240
    assert all(0 <= gaze.x <= 1 and 0 <= gaze.y <= 1 for gaze in trace.gazes)


@pytest.mark.parametrize("seed", [0, 1, np.int64(7), MOST_SEED])
def test_seeds_of_any_integer_type_are_kept(seed):
    assert require_seed(seed) == int(seed)


@pytest.mark.parametrize("seed", [-1, MOST_SEED + 1, 1 << 64, 0.5, 1e308, np.nan, "7", None])
def test_other_seeds_are_refused(seed):
    with pytest.raises(UserError, match=f"must be a whole number from 0 to {MOST_SEED}$"):
        require_seed(seed)
