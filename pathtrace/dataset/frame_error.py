"""How far a denoised frame is from the truth, as two independent halves of its samples tell.

With `a` and `b` the denoised halves, `A` and `B` what was traced, all independent between the halves, the
mean of `a` and `b` has the squared error

    |(a + b) / 2 - truth|^2  =  |a - b|^2 / 4  +  (a - A) (b - B)

in expectation: variance that denoising left, and the square of the bias that it caused. That is Noise2Noise's
independence of targets (Lehtinen et al. 2018); no square of a noisy value is left in it. Still, where light
is found by rare bright samples, the product is mostly noise. What the denoiser changes when it gets twice the
samples, |d - (a + b) / 2|^2 with `d` denoised from both halves, tells the bias as well, with hardly any noise
but only up to a factor. Both estimates of it are weighed by how sure they are.

Light that no sample found, and the bias of paths that end in a cache, are in neither half: the error stated
is from the mean that the same integrator finds with many more samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, decibels, srgb_from_radiance, srgb_slope
from pathtrace.trace.traced_images import TracedImage

# Squared bias over the squared change by twice the samples: of five scenes and 1 to 16 samples per half, 3.8
# to 9.2, about 5 where there is little noise.
_BIAS_PER_CHANGE = 6.0
# How sure that is, as a share of it: the one with which scenes that it was not fitted to are stated best.
_PRIOR_DEVIATION = 0.25
# The bias is no less than this share of what the change tells, whatever the noisy product says.
_LEAST_SHARE = 0.1
# Squared error of a frame from all samples over that of the mean of its denoised halves: 0.84 to 1.06.
_JOINT_SHARE = 0.95
# Largest residual that counts, in sRGB values: of a sample so bright, hardly another one was found.
_LARGEST_RESIDUAL = 16.0
# Side in pixels of the blocks whose scatter says how sure the product is: errors within one are correlated.
_BLOCK = 16


@dataclass(frozen=True)
class FrameError:
    """Error of a denoised frame, or the mean of several; squares of sRGB values clipped to 0..1."""

    variance: float  # of each denoised half
    change: float  # of the denoised frame from half its samples to all
    product: float  # of the halves' residuals: their squared bias; may be negative
    deviation: float  # standard deviation of the product; inf if not known

    @property
    def mse(self) -> float:
        """Mean squared error of the frame denoised from all samples."""
        told = _BIAS_PER_CHANGE * self.change
        prior = _PRIOR_DEVIATION * told
        # Weight, 0 to 1, of the product against what the change tells of the bias.
        trust = float(prior**2 / (prior**2 + self.deviation**2)) if prior > 0 else 0.0
        bias = max(trust * self.product + (1 - trust) * told, _LEAST_SHARE * told)
        return _JOINT_SHARE * (self.variance / 2 + bias)

    @property
    def psnr_db(self) -> float:
        """Peak signal-to-noise ratio in dB of the frame denoised from all samples; at most 120."""
        return decibels(self.mse)


def frame_error(one: TracedImage, other: TracedImage, denoised: Image | None = None) -> FrameError:
    """Error of a frame that is denoised from two halves of its samples; ValueError if they differ in size.

    A frame traced at once has a little less. The halves are of as many samples, from different seeds;
    `denoised` is `one.mixed(other, 0.5).denoised()`, if it is there already.
    """
    if one.radiance.shape != other.radiance.shape:
        raise ValueError(f"halves of {one.radiance.shape} and {other.radiance.shape}; must be of one size")
    halves = one.denoised(), other.denoised()
    both = one.mixed(other, 0.5).denoised() if denoised is None else denoised
    mean = np.float32(0.5) * (halves[0] + halves[1])
    # Noisy radiance cannot be compared on the curve itself, whose bend would turn its noise into a bias.
    slope = srgb_slope(mean)
    first, second = (
        np.clip(slope * (clean - noisy.radiance), -_LARGEST_RESIDUAL, _LARGEST_RESIDUAL)
        for clean, noisy in zip(halves, (one, other), strict=True)
    )
    product, deviation = _mean_and_deviation(first * second)
    return FrameError(_squared_distance(*halves) / 2, _squared_distance(both, mean), product, deviation)


def mean_frame_error(errors: Sequence[FrameError]) -> FrameError:
    """The mean error of several frames, whose PSNR is that of the mean square; ValueError without any."""
    if not errors:
        raise ValueError("no frames to have an error")
    columns = list(zip(*map(astuple, errors), strict=True))
    variance, change, product = (float(np.mean(column)) for column in columns[:3])
    deviation = float(np.sqrt(np.sum(np.square(columns[3]))) / len(errors))
    return FrameError(variance, change, product, deviation)


def _squared_distance(one: Image, other: Image) -> float:
    """Mean squared difference of two images' sRGB values."""
    difference = srgb_from_radiance(one) - srgb_from_radiance(other)
    return float(np.mean(np.square(difference), dtype=np.float64))


def _mean_and_deviation(values: NDArray[np.float32]) -> tuple[float, float]:
    """Mean of (H, W, 3) values and its standard deviation; inf for an image of a single block."""
    rows, columns = (np.arange(0, side, _BLOCK) for side in values.shape[:2])
    sums = np.add.reduceat(values.sum(axis=2, dtype=np.float64), rows, axis=0)
    sums = np.add.reduceat(sums, columns, axis=1)
    if sums.size < 2:
        return float(sums.sum()) / values.size, np.inf
    return float(sums.sum()) / values.size, float(np.sqrt(sums.size) * sums.std(ddof=1)) / values.size
