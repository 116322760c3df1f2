"""PSNR and SSIM together."""

from __future__ import annotations

from compose.image.colour import Image
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.ssim import ssim


def quality(image: Image, reference: Image) -> dict[str, float]:
    """PSNR and SSIM of (H, W, 3) linear radiance, under the names that all reports use."""
    return {"psnr": psnr(image, reference), "ssim": ssim(image, reference)}
