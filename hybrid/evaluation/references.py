"""References of an evaluation: how many samples they have, their files, and their remaining error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.image.colour import Image
from hybrid.evaluation.settings import FOVEAL_REFERENCE, EvaluationSettings
from hybrid.measure.reference import Reference
from hybrid.measure.regions import regions
from hybrid.output.images import read_exr, write_exr


def reference_samples(settings: EvaluationSettings) -> NDArray[np.int64]:
    """(H * W,) samples of each pixel: FOVEAL_REFERENCE times as many in the disc."""
    samples = np.full(settings.width * settings.height, settings.reference_spp, dtype=np.int64)
    samples[settings.frame.foveation.region(settings.width, settings.height).pixels] *= FOVEAL_REFERENCE
    return samples


def stored_reference(
    file: Path, make: Callable[[], Reference], size: tuple[int, int] | None = None
) -> Reference:
    """The reference in an EXR file; made and written now if there is none, or it is damaged.

    Args:
        file: the file.
        make: makes the reference.
        size: width and height that it must have.

    Raises:
        UserError: the file cannot be written.
    """
    try:
        return _reference(read_exr(file, size))
    except (UserError, KeyError):
        made = make()
        first, second = made.halves
        write_exr(file, {"": made.radiance, "first": first, "second": second, "error": made.errors})
        return _reference(read_exr(file, size))


def reference_errors(settings: EvaluationSettings, number: int, reference: Reference) -> list[dict[str, Any]]:
    """Rows of view, region and PSNR of a reference against the truth, in dB."""
    parts = regions(settings.frame.foveation, reference.radiance)
    return [
        {"view": number, "region": name, "psnr": reference.psnr(part.mask)} for name, part in parts.items()
    ]


def _reference(channels: dict[str, NDArray[np.float32]]) -> Reference:
    """The reference of what `stored_reference` writes.

    Raises:
        KeyError: a channel is missing.
    """
    halves = _image(channels, "first."), _image(channels, "second.")
    return Reference(_image(channels, ""), halves, channels["error.V"])


def _image(channels: dict[str, NDArray[np.float32]], prefix: str) -> Image:
    return np.stack([channels[prefix + channel] for channel in "RGB"], axis=-1)
