"""PSNR, and SSIM as a map, as a mean, and weighted by what the eye resolves."""

from __future__ import annotations

from compose.image.colour import Image
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.ssim import ssim


def quality(image: Image, reference: Image) -> dict[str, float]:
    """PSNR and SSIM under the names that every report uses."""
    return {"psnr": psnr(image, reference), "ssim": ssim(image, reference)}
