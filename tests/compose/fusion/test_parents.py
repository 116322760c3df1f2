"""What is fused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from compose.fusion.parents import PARENTS
from tests.compose.fusion.examples import example, in_torch

GIVEN = example(8, 4, size=16).parents


def test_parents_are_listed_in_the_order_of_their_weights():
    assert PARENTS == ("traced", "denoised", "relit", "splat")


@pytest.mark.parametrize("given", [GIVEN, in_torch(GIVEN)], ids=["numpy", "torch"])
@pytest.mark.parametrize("name", ["variance", "denoised", "splat", "albedo", "count"])
def test_an_image_of_another_size_is_refused_by_name(name, given):
    with pytest.raises(ValueError, match=f"^{name} is .* to match traced"):
        replace(given, **{name: getattr(given, name)[:-1]})


def test_radiance_needs_three_channels_and_the_count_one():
    for given in (GIVEN, in_torch(GIVEN)):
        with pytest.raises(ValueError, match=r"^traced is \(16, 16, 2\), must be \(16, 16, 3\)"):
            replace(given, traced=given.traced[..., :2])
        with pytest.raises(ValueError, match=r"^count is \(16, 16, 3\), must be \(16, 16, 1\)"):
            replace(given, count=given.traced)


def test_denoised_samples_may_be_missing():
    given = replace(GIVEN, denoised=None)
    assert "denoised" not in given.images()
    assert set(given.images()) == set(GIVEN.images()) - {"denoised"}
