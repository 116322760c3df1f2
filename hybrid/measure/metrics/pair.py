"""Whether two images can be compared at all; every metric asks first."""

from __future__ import annotations

import numpy as np

from compose.base.errors import UserError
from compose.image.colour import Image


def checked_pair(image: Image, reference: Image, name: str = "the image") -> None:
    """Checks that two images can be compared.

    Some metrics would ignore a pixel that is not finite and others would yield NaN: neither is a figure.

    Args:
        image, reference: (..., 3) linear radiance.
        name: of the image, for the message.

    Raises:
        UserError: their sizes differ, they have no pixels, or one has a pixel that is not finite.
    """
    if image.shape != reference.shape:
        raise UserError(
            f"{name} is {_size(image)} pixels, its reference {_size(reference)}: they cannot be compared"
        )
    if image.size == 0:
        raise UserError(f"{name} has no pixels: it cannot be compared")
    for one, what in ((image, name), (reference, f"the reference of {name}")):
        bad = int(np.count_nonzero(~np.isfinite(one).all(axis=-1)))
        if bad:
            raise UserError(f"{what} has {bad} pixels that are not finite: it cannot be compared")


def _size(image: Image) -> str:
    return " x ".join(str(side) for side in reversed(image.shape[:-1]))
