"""What is fused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.fusion.parents import CHANNELS, PARENTS, Parents
from tests.available import available_arrays
from tests.compose.arrays_of import floats
from tests.compose.fusion.examples import example

GIVEN = example(8, 4, size=16).parents


def test_parents_are_listed_in_the_order_of_their_weights():
    assert PARENTS == ("traced", "denoised", "relit", "splat")


@pytest.mark.parametrize("name", CHANNELS)
@pytest.mark.parametrize("part", [np.s_[:-1], np.s_[..., :0]], ids=["rows", "channels"])
def test_an_image_of_another_size_is_refused_by_name(name, part):
    shape, images = (16, 16), {of: np.moveaxis(getattr(GIVEN, of), 2, 0) for of in CHANNELS}
    images[name] = np.moveaxis(getattr(GIVEN, name)[part], 2, 0)
    arrays = available_arrays()
    channels = {of: [floats(arrays, channel.ravel()) for channel in image] for of, image in images.items()}
    with pytest.raises(ValueError, match=f"^{name} has channels of .* must have . of 256"):
        Parents.of(arrays, shape, channels)


def test_denoised_samples_must_have_all_pixels():
    arrays = available_arrays()
    channels = {of: [floats(arrays, np.zeros(12))] * count for of, count in CHANNELS.items()}
    with pytest.raises(ValueError, match=r"^denoised has 12 values, must have 3 of 12 pixels"):
        Parents.of(arrays, (3, 4), channels, floats(arrays, np.zeros(12)))


@pytest.mark.parametrize("denoised", [False, True])
def test_images_come_back_as_they_were(denoised):
    given = GIVEN if denoised else replace(GIVEN, denoised=None)
    found = given.on_device().images()
    assert set(found) == set(given.images())
    for name, image in given.images().items():
        np.testing.assert_array_equal(found[name], image)
