"""The composite is a convex combination of its parents, and so is the periphery of its layer images."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import LayerRange, detail_map
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from tests.properties import twin
from tests.properties.blending import blended, image_of, weight_image
from tests.properties.effort import tried

SIDES = st.integers(1, 70)
RADII = st.one_of(st.just(0.0), st.floats(0, 200), st.floats(1e-6, 1e-3))
GAZES = st.builds(Gaze, st.floats(-1, 2), st.floats(-1, 2))
FOVEATIONS = st.builds(
    lambda gaze, radius, share: Foveation(gaze, radius, radius * share),
    GAZES,
    RADII,
    st.one_of(st.sampled_from([0.0, 1.0, 1 - 1e-7]), st.floats(0, 1)),
)


def parents(seed: int, height: int, width: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) and (D, 3) radiances from 1e-6 to 1e6 and 0."""
    rng = np.random.default_rng(seed)
    draw = lambda *shape: (10 ** rng.uniform(-6, 6, shape) * rng.integers(0, 2, shape)).astype(np.float32)  # noqa: E731
    return draw(height, width, 3), draw(count, 3)


@tried(60)
@given(FOVEATIONS, SIDES, SIDES, st.integers(0, 1000))
def test_the_composite_lies_between_its_parents(foveation, width, height, seed):
    region = foveation.region(width, height)
    periphery, fovea = parents(seed, height, width, len(region.pixels))
    composite = blended(periphery, fovea, region)
    traced = image_of(region, fovea)
    weight = weight_image(region)[..., None]
    low, high = np.minimum(periphery, traced), np.maximum(periphery, traced)
    # Exact at both ends.
    np.testing.assert_array_equal(composite, np.where(weight == 1, traced, composite))
    np.testing.assert_array_equal(composite, np.where(weight == 0, periphery, composite))
    # Rounding of two products and their sum.
    assert (composite >= low * (1 - 3e-7)).all()
    assert (composite <= high * (1 + 3e-7)).all()


@tried(60)
@given(FOVEATIONS, SIDES, SIDES, st.integers(0, 1000))
def test_the_blend_is_that_of_the_float64_twin(foveation, width, height, seed):
    region = foveation.region(width, height)
    periphery, fovea = parents(seed, height, width, len(region.pixels))
    found = blended(periphery, fovea, region).astype(np.float64)
    expected = twin.blended(periphery.astype(np.float64), fovea, foveation, region.pixels)
    outer, inner = (radius / 100 * height for radius in (foveation.fov_a, foveation.fov_b))
    if outer - inner > 1e-3:
        # A weight is (outer - r) / (outer - inner): r is rounded to 1e-7 of the frame.
        bound = 1e-6 * (1 + (width + height + outer) / (outer - inner))
        traced = image_of(region, fovea)
        assert (np.abs(found - expected) <= bound * (np.maximum(periphery, traced) + 1e-30)).all()


@tried(60)
@given(FOVEATIONS, SIDES, SIDES)
def test_weights_are_shares(foveation, width, height):
    region = foveation.region(width, height)
    weight = weight_image(region)
    assert ((weight >= 0) & (weight <= 1)).all()
    # Splats are hidden only where their weight is 0: what is not rasterized does not show.
    hidden = ~region.peripheral_tiles(8).repeat(8, axis=0).repeat(8, axis=1)[:height, :width]
    np.testing.assert_array_equal(weight[hidden], 1)
    # Weight falls with the distance from the gaze.
    y, x = np.mgrid[:height, :width] + 0.5
    radius = np.hypot(x - region.centre[0], y - region.centre[1])
    order = np.argsort(radius, axis=None)
    assert (np.diff(weight.ravel()[order]) <= 1e-5 * np.maximum(1, radius.max())).all()


@tried(60)
@given(
    GAZES,
    st.integers(1, 2000),
    st.integers(1, 2000),
    st.sampled_from(sorted(ACUITY_MODELS)),
    st.floats(0, 100),
    st.integers(1, 5),
    st.integers(0, 1000),
)
def test_the_weights_of_all_layer_images_sum_to_one(gaze, width, height, model, fov_b, layers, seed):
    rng = np.random.default_rng(seed)
    finest = float(10 ** rng.uniform(-2, 0.3))
    rates = tuple(sorted((int(rate) for rate in rng.integers(0, 3, layers)), reverse=True))
    allowed = LayerRange(finest, rates, int(rng.integers(1, layers + 1)))
    corners = (-(-height // 16) + 1, -(-width // 16) + 1)
    saliency = rng.random(corners).astype(np.float32) if seed % 2 else None
    display = DISPLAYS[sorted(DISPLAYS)[seed % len(DISPLAYS)]]
    detail = detail_map(display, gaze, width, height, ACUITY_MODELS[model], fov_b, allowed, saliency)
    weights = np.array([detail.weight(number) for number in range(len(detail.steps))])
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-6)
    assert (weights >= 0).all()
    # No more than two layer images meet anywhere.
    assert ((weights > 0).sum(axis=0) <= 2).all()
    assert np.isfinite(detail.cutoff).all()
