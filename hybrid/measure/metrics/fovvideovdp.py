"""FovVideoVDP (Mantiuk et al. 2021), if it is installed: its licence makes it optional."""

from __future__ import annotations

import os
import sys
import warnings
from functools import lru_cache
from typing import Any

import numpy as np

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, srgb_from_radiance

# Contrast of a good monitor in a lit room.
_CONTRAST = 1000
INSTALL = "JOD needs FovVideoVDP (CC BY-NC 4.0): pip install 'foveated-hybrid-renderer[metrics]'"


def jod(image: Image, reference: Image, display: Display, gaze: Gaze) -> float | None:
    """Quality of a frame for a viewer with that gaze, in just-objectionable differences (JOD).

    Args:
        image, reference: (H, W, 3) linear radiance.
        display: gives pixels per degree and luminance.
        gaze: in fractions of the frame.

    Returns:
        10 for no difference, less for visible ones; None if the metric is not installed.
    """
    try:
        _pyfvvdp()
        import torch
    except ImportError:
        return None
    height, width = image.shape[:2]
    score, _ = _metric(width, height, display).predict(
        srgb_from_radiance(image),
        srgb_from_radiance(reference),
        dim_order="HWC",
        fixation_point=torch.tensor(gaze.pixel(width, height)),
    )
    return float(score)


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
