"""Composites and gradients in float32 against their float64 twins."""

from __future__ import annotations

import numpy as np
import pytest

from tests.extremes import extreme
from tests.properties import rounding
from tests.properties.half_precision import halved, normal_errors

# 20 scenes must stay below these, relative to radiance where that is above 1, wherever the definition
# does not jump.
BOUNDS = {0.0: 2e-4, 2.0: 2e-4}


def worst(errors: rounding.Errors, cause: str) -> float:
    return float(np.concatenate(errors.relative[cause]).max(initial=0))


@extreme(
    "composites of 20 random scenes",
    given="depths, sizes and axes over 3 to 4 decades, radiances up to 10,000, eye at the origin",
    expected="rounding below 2e-4 of the radiance",
)
def test_rounding_of_composites(got):
    assert got(worst(rounding.composite_errors(range(20), 0.0), "rounding"), ".1e") < BOUNDS[0.0]


def test_rounding_of_composites_away_from_the_origin():
    errors = rounding.composite_errors(range(20), 2.0)
    assert worst(errors, "rounding") < BOUNDS[2.0]
    # Most pixels are nowhere near a jump, and their typical error is that of a few roundings.
    values = np.concatenate(errors.relative["rounding"])
    assert len(values) > 0.75 * sum(len(part) for parts in errors.relative.values() for part in parts)
    assert np.median(values) < 1e-6


@pytest.mark.long
def test_rounding_of_a_thousand_composites():
    """Each jump is bounded as well: a cut at 1/255 by that, a stop at 1e-4 by that, times radiance."""
    errors = rounding.composite_errors(range(1000), 0.0)
    assert worst(errors, "rounding") < BOUNDS[0.0]
    # Radiance reaches 50 and its harmonics add to that.
    assert worst(errors, "stop") < 1e-4 * 100
    assert worst(errors, "cut") < 100 / 255


def test_rounding_of_gradients():
    """Relative to the length of each gradient; `python -m tests.properties.rounding` tries more scenes."""
    errors = rounding.gradient_errors(range(12), 0.0)
    assert set(errors) == {"means", "log_scales", "rotations", "opacity_logits", "sh"}
    for name, values in errors.items():
        assert np.median(values) < 1e-5, name
        assert values.max() < 5e-3, name


def test_half_precision_of_captured_features():
    """What 16 bits leave of any normal and albedo: eleven significant bits."""
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(40, 50, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    assert normal_errors(normal).max() < 0.04
    albedo = rng.random((40, 50, 3)).astype(np.float32)
    np.testing.assert_allclose(halved(albedo), albedo, rtol=2**-11, atol=2**-25)
