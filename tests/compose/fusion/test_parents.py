"""What is fused, and named channels of stacked images."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from compose.fusion.parents import PARENTS, Channels, Parents
from tests.compose.fusion.examples import example, in_torch

GIVEN = example(8, 4, size=16).parents


def test_parents_are_listed_in_the_order_of_their_weights():
    assert PARENTS == ("traced", "denoised", "splat")
    assert all(hasattr(GIVEN, name) for name in PARENTS)


@pytest.mark.parametrize("given", [GIVEN, in_torch(GIVEN)], ids=["numpy", "torch"])
@pytest.mark.parametrize("name", ["variance", "denoised", "splat", "albedo", "normal", "count"])
def test_an_image_of_another_size_is_refused_by_name(name, given):
    with pytest.raises(ValueError, match=f"^{name} is .* to match traced"):
        replace(given, **{name: getattr(given, name)[:-1]})


def test_radiance_needs_three_channels_and_the_count_one():
    for given in (GIVEN, in_torch(GIVEN)):
        with pytest.raises(ValueError, match=r"^traced is \(16, 16, 2\), must be \(16, 16, 3\)"):
            replace(given, traced=given.traced[..., :2])
        with pytest.raises(ValueError, match=r"^count is \(16, 16, 3\), must be \(16, 16, 1\)"):
            replace(given, count=given.traced)


def test_the_better_denoiser_is_the_default():
    assert isinstance(GIVEN, Parents)
    assert not GIVEN.quick


CHANNELS = Channels({"colour": 3, "depth": 1})


def images() -> dict[str, torch.Tensor]:
    return {"depth": torch.full((2, 1, 4, 5), 7.0), "colour": torch.rand(2, 3, 4, 5)}


def test_images_are_stacked_in_the_declared_order():
    given = images()
    stack = CHANNELS.stacked(given)
    assert CHANNELS.total == 4
    assert stack.shape == (2, 4, 4, 5)
    assert torch.equal(stack[:, 0:3], given["colour"])
    assert torch.equal(stack[:, 3:4], given["depth"])


def test_parts_are_views_of_the_stack_by_name():
    stack = CHANNELS.stacked(images())
    parts = CHANNELS.parts(stack)
    assert list(parts) == ["colour", "depth"]
    parts["depth"][:] = -1
    assert (stack[:, 3] == -1).all()
    assert (stack[:, :3] >= 0).all()


def test_stacks_need_no_batch():
    given = {name: image[0] for name, image in images().items()}
    assert torch.equal(CHANNELS.parts(CHANNELS.stacked(given))["colour"], given["colour"])


@pytest.mark.parametrize("names", [["colour"], ["colour", "depth", "normal"], []])
def test_missing_and_superfluous_images_are_refused(names):
    given = {name: images().get(name, torch.zeros(2, 1, 4, 5)) for name in names}
    with pytest.raises(ValueError, match="channels are"):
        CHANNELS.stacked(given)


def test_an_image_of_another_width_is_refused():
    with pytest.raises(ValueError, match=r"'depth': 2.*must be .*'depth': 1"):
        CHANNELS.stacked({**images(), "depth": torch.zeros(2, 2, 4, 5)})
