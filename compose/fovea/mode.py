"""How a fovea is made."""

from __future__ import annotations

from enum import Enum


class FoveaMode(Enum):
    """How a fovea is made from path-traced samples.

    Attributes:
        RAW: their mean, unbiased.
        DENOISED: their mean, denoised.
        FUSED: one estimate from samples, denoised samples and the splats under the disc.
    """

    RAW = "raw"
    DENOISED = "denoised"
    FUSED = "fused"
