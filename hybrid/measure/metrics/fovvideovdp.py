"""FovVideoVDP (Mantiuk et al. 2021), if it is installed: its licence makes it optional."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, srgb_from_radiance
from hybrid.measure.metrics.pair import checked_pair

# Contrast of a good monitor in a lit room.
_CONTRAST = 1000
# Smaller images have no band of contrast, in pixels per side.
_LEAST_SIZE = 4
# At more pixels per degree, constructing the metric takes minutes to hours: its time grows with their square.
_MOST_DENSITY = 300
INSTALL = "JOD needs FovVideoVDP (CC BY-NC 4.0): pip install 'foveated-hybrid-renderer[metrics]'"


def jod(image: Image, reference: Image, display: Display, gaze: Gaze) -> float | None:
    """Quality of a frame for a viewer with that gaze, in just-objectionable differences (JOD).

    Args:
        image, reference: (H, W, 3) linear radiance.
        display: gives pixels per degree and luminance.
        gaze: in fractions of the frame.

    Returns:
        10 for no difference, less for visible ones. None if the metric is not installed; if the images are
        smaller than 4 x 4 pixels; if the display has over 300 pixels per degree; or if the images differ but
        neither has any contrast: the metric sees contrast only, so that black in place of white has 10.

    Raises:
        UserError: the two images cannot be compared.
    """
    return jod_of_video([image], [reference], 0.0, display, gaze)


def jod_of_video(
    images: Sequence[Image], references: Sequence[Image], rate: float, display: Display, gaze: Gaze
) -> float | None:
    """Quality of frames that follow each other, as of `jod` for a single one.

    Args:
        images, references: F of (H, W, 3) linear radiance each, at least one.
        rate: frames per second; of no meaning for a single frame.
        display, gaze: as of `jod`; the gaze rests.

    Raises:
        UserError: two images cannot be compared.
        ValueError: there are not as many images as references.
    """
    for image, reference in zip(images, references, strict=True):
        checked_pair(image, reference)
    height, width = images[0].shape[:2]
    if min(height, width) < _LEAST_SIZE or display.pixels_per_degree > _MOST_DENSITY:
        return None
    shown, expected = (np.stack([srgb_from_radiance(one) for one in all_]) for all_ in (images, references))
    if _is_flat(shown) and _is_flat(expected) and not np.array_equal(shown, expected):
        return None
    try:
        _pyfvvdp()
        import torch
    except ImportError:
        return None
    score, _ = _metric(width, height, display).predict(
        shown,
        expected,
        dim_order="FHWC",
        frames_per_second=rate if len(images) > 1 else 0,
        fixation_point=torch.tensor(gaze.pixel(width, height)),
    )
    return float(score)


def _is_flat(shown: Image) -> bool:
    """Whether all pixels of frames (F, H, W, 3) are equal."""
    return bool((shown == shown[0, 0, 0]).all())


@lru_cache(maxsize=8)
def _metric(width: int, height: int, display: Display) -> Any:
    """The metric for images of one size; constructing it takes as long as using it."""
    import torch

    pyfvvdp = _pyfvvdp()
    across = float(np.degrees(2 * np.arctan(width / 2 / display.focal)))
    return pyfvvdp.fvvdp(
        display_geometry=pyfvvdp.fvvdp_display_geometry((width, height), fov_horizontal=across),
        display_photometry=pyfvvdp.fvvdp_display_photo_eotf(
            display.luminance, contrast=_CONTRAST, EOTF="sRGB"
        ),
        # Without it the fixation is ignored.
        foveated=True,
        device=torch.device("cpu"),
    )


def _pyfvvdp() -> Any:
    """The package, also in a process that has imported pip.

    Wheels that complete their installation when Python first starts (LLVM's does) import pip. Before
    Python 3.12, setuptools then stops supplying `distutils` and fails on its own check; setuptools is
    imported by torch's benchmarks, and those by pyfvvdp. Asking for the `distutils` of the standard
    library skips the check.
    """
    if "pip" not in sys.modules or sys.version_info >= (3, 12) or "SETUPTOOLS_USE_DISTUTILS" in os.environ:
        import pyfvvdp

        return pyfvvdp
    os.environ["SETUPTOOLS_USE_DISTUTILS"] = "stdlib"
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Reliance on distutils", UserWarning)
            import pyfvvdp

            return pyfvvdp
    finally:
        del os.environ["SETUPTOOLS_USE_DISTUTILS"]
