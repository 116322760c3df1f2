"""The training loss, with the structural similarity in it.

Value and gradient come out of the same kernels: of a loss that is computed at every step, both are needed.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
import torch
from torch.autograd.function import once_differentiable

from compose.base.arrays import Arrays, constant
from compose.base.frozen import collector_paused
from compose.image.colour import SRGB_DARK, SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, SRGB_SLOPE
from splat.raster.differentiable import Context, detached

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt

    # The maps' numbers at an index, under a mask; and what is stored there.
    Load = Callable[[UInt, Bool], list[Float]]
    Finish = Callable[[UInt, list[Float]], list[Float]]

TAPS = 11
_SIGMA = 1.5
_offsets = np.arange(TAPS) - TAPS // 2
_gaussian = np.exp(-(_offsets**2) / (2 * _SIGMA**2))
# Gaussian window of 11 taps with a sum of 1 (Wang et al. 2004).
WEIGHTS: list[float] = (_gaussian / _gaussian.sum()).tolist()
CHANNELS = 3
# Neighbouring results that one lane computes: together they read 18 pixels, one by one 88.
_RUN = 8


@dataclass(frozen=True)
class Axis:
    """Where the window moves: along the rows or along the columns of an image."""

    lines: int  # rows or columns that it moves along
    before: int  # before, after: pixels of each line before and after
    after: int
    is_horizontal: bool  # whether the lines are rows
    padding: int  # pixels of zeros that are added at both ends of each line first

    @staticmethod
    def over(lines: int, length: int, is_horizontal: bool) -> Axis:
        """Over the valid region of an image of so many rows, or columns, of that length."""
        return Axis(lines, length, length - TAPS + 1, is_horizontal, 0)

    def transposed(self) -> Axis:
        """What takes derivatives by the results to derivatives by the pixels: the window is symmetric."""
        return Axis(self.lines, self.after, self.before, self.is_horizontal, TAPS - 1)

    @property
    def runs(self) -> int:
        """Lanes per line."""
        return -(-self.after // _RUN)

    def sizes(self, arrays: Arrays) -> list[UInt]:
        """Pixels per line before and after, lanes per line, and floats per line, read from memory.

        The same kernels serve images of all sizes.
        """
        return [arrays.constant(n) for n in (self.before, self.after, self.runs, self.lines * CHANNELS)]


def blur(
    arrays: Arrays,
    axis: Axis,
    sizes: list[UInt],
    load: Load,
    finish: Finish = lambda index, sums: sums,
) -> list[Float]:
    """Applies the window along one axis to several maps at once.

    Args:
        sizes: those of the axis; recorded functions take them as arguments.
        load: the maps' numbers at an index into an image of `before` pixels per line, under a mask.
        finish: what is stored at an index into the results, flat with `after` pixels per line, from the maps'
            blurred numbers there.
    """
    plain = arrays.plain
    lane = dr.arange(plain.UInt, axis.runs * axis.lines * CHANNELS)
    before, after, across_runs, stride = sizes
    if axis.is_horizontal:
        rest, channel = lane // CHANNELS, lane % CHANNELS
        line = rest // across_runs
        first, stride = (rest - line * across_runs) * _RUN, plain.UInt(CHANNELS)
        start_in, start_out = line * before * CHANNELS + channel, line * after * CHANNELS + channel
    else:
        run = lane // stride
        first, start_in = run * _RUN, lane - run * stride
        start_out = start_in
    columns = []
    for k in range(_RUN + TAPS - 1):
        position = plain.Int(first) + (k - axis.padding)
        inside = (position >= 0) & (position < plain.Int(before))
        columns.append(load(start_in + plain.UInt(dr.maximum(position, 0)) * stride, inside))
    size = axis.lines * axis.after * CHANNELS
    results: list[Float] = []
    for r in range(_RUN):
        sums = []
        for values in zip(*columns[r : r + TAPS], strict=True):
            total = values[0] * WEIGHTS[0]
            for value, weight in zip(values[1:], WEIGHTS[1:], strict=True):
                total = dr.fma(value, weight, total)
            sums.append(total)
        inside = first + r < after
        index = dr.select(inside, start_out + (first + r) * stride, 0)
        stored = finish(index, sums)
        results = results or [dr.empty(plain.Float, size) for _ in stored]
        for result, value in zip(results, stored, strict=True):
            dr.scatter(result, value, index, inside, mode=dr.ReduceMode.Permute)
    dr.eval(results)
    return results


# Smaller images do not hold the similarity's window.
SMALLEST_SIDE = TAPS
_C1, _C2 = 0.01**2, 0.03**2
SSIM_WEIGHT = 0.2
_BRIGHT_SLOPE = SRGB_SCALE / SRGB_GAMMA


class FrameTarget:
    """A frame to match: its radiance, (H, W, 3) linear, float32 or float16, at least 11 pixels a side.

    What depends on the frame alone is computed again each time: kept, it would take three times the memory of
    the frame, of every frame of a training, and save a fiftieth of a step.
    """

    def __init__(self, arrays: Arrays, radiance: torch.Tensor):
        self._arrays, self._radiance = arrays, radiance
        seen, _ = _logarithmic(self._frame())
        # Variances do not depend on where zero is. With zero amid the frame's own values, little cancels in
        # them; where all is very bright, rounding would otherwise exceed the similarity's constants.
        means = arrays.to_torch(seen, torch.device("cpu")).reshape(-1, CHANNELS).double().mean(dim=0)
        self._zero = arrays.plain.Float(means.float().numpy())

    def loss(self, rendered: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(1 - w) L1 + w (1 - SSIM) of radiance (H, W, 3) on a scale for lamps beside shadows (Fov-GS Eq. 4).

        The second result is the absolute error per pixel (H, W), which has no gradient.
        """
        return _Loss.apply(self, rendered)

    def loss_and_gradient(self, rendered: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Loss, error per pixel (H, W), and the derivative of the loss by the radiance (H, W, 3)."""
        arrays, (height, width) = self._arrays, rendered.shape[:2]
        sizes = [axis.sizes(arrays) for axis in _axes(width, height)]
        recorded = _recorded(arrays, width, height)
        # Means of as many numbers as there are.
        windows = (height - TAPS + 1) * (width - TAPS + 1) * CHANNELS
        parts = (1 - SSIM_WEIGHT) / rendered.numel(), -SSIM_WEIGHT / windows
        shares = [constant(arrays.plain.Float, part) for part in parts]
        with collector_paused():
            found = recorded(detached(arrays, rendered), self._frame(), self._zero, sizes, shares)
        loss, error, gradient = (arrays.to_torch(array, rendered.device) for array in found)
        return loss[0], error.reshape(height, width), gradient.reshape(rendered.shape)

    def _frame(self) -> Float:
        return detached(self._arrays, self._radiance.float())


def _axes(width: int, height: int) -> list[Axis]:
    """Where the window moves: over the image, and back over the derivatives by its means."""
    there = [Axis.over(height, width, True), Axis.over(width - TAPS + 1, height, False)]
    return [*there, *(axis.transposed() for axis in reversed(there))]


@lru_cache(maxsize=16)
def _recorded(arrays: Arrays, width: int, height: int) -> Callable[..., list[Float]]:
    """The kernels of a loss on images of one size; to trace them takes longer than small images do."""
    return dr.freeze(lambda *given: _Similarity(arrays, _axes(width, height), *given).loss_and_gradient())


# Dr.Jit complains of arrays that outlive it.
atexit.register(_recorded.cache_clear)


class _Similarity:
    """An image compared with a frame, both counted from a `zero` (3,) of each channel.

    `shares` are what each number's distance adds to the loss, and each window's similarity.
    """

    def __init__(
        self,
        arrays: Arrays,
        axes: list[Axis],
        rendered: Float,
        frame: Float,
        zero: Float,
        sizes: list[list[UInt]],
        shares: list[Float],
    ):
        self._arrays, self._axes, self._sizes = arrays, axes, sizes
        self._zero, (self._by_distance, self._by_similarity) = zero, shares
        seen, self._slope = _logarithmic(rendered)
        own, _ = _logarithmic(frame)
        offset = self._zero_at(dr.arange(arrays.plain.UInt, dr.width(rendered)))
        self._seen, self._own = seen - offset, own - offset
        self._distance = dr.abs(self._seen - self._own)
        dr.eval(self._seen, self._own, self._slope, self._distance)

    def loss_and_gradient(self) -> list[Float]:
        error = dr.block_sum(self._distance, CHANNELS) / CHANNELS
        dissimilarity, *flow = self._compared()
        gradient = self._gradient(flow)
        loss = self._by_distance * dr.sum(self._distance) - self._by_similarity * dr.sum(dissimilarity)
        dr.eval(error, loss)
        return [loss, error, gradient]

    def _compared(self) -> list[Float]:
        """Per window 1 - SSIM, and SSIM's derivatives by the means of the image, its square and its product.

        The frame is the other factor of the product.
        """
        plain = self._arrays.plain

        def load(index: UInt, inside: Bool) -> list[Float]:
            a, b = (dr.gather(plain.Float, image, index, inside) for image in (self._seen, self._own))
            return [a, a * a, a * b, b, b * b]

        def finish(index: UInt, means: list[Float]) -> list[Float]:
            mean, square, product, own_mean, own_square = means
            zero = self._zero_at(index)
            level, own_level = mean + zero, own_mean + zero
            light = dr.fma(level, level, dr.fma(own_level, own_level, _C1))
            variances = dr.fma(-mean, mean, square) + dr.fma(-own_mean, own_mean, own_square)
            by_light, by_contrast = dr.rcp(light), dr.rcp(variances + _C2)
            alike = dr.fma(2 * level, own_level, _C1) * by_light
            structure = dr.fma(2, dr.fma(-mean, own_mean, product), _C2) * by_contrast
            similarity = alike * structure
            by_square, by_product = -similarity * by_contrast, 2 * alike * by_contrast
            by_level = 2 * (own_level * structure - similarity * level) * by_light
            by_mean = by_level - by_product * own_mean - 2 * by_square * mean
            return [1 - similarity, by_mean, by_square, by_product]

        rows = self._blurred(0, load)
        return self._blurred(1, self._loaded(rows), finish)

    def _gradient(self, flow: list[Float]) -> Float:
        """Derivative of the loss by the radiance from SSIM's derivatives by the means of `_compared`."""
        plain = self._arrays.plain

        def finish(index: UInt, sums: list[Float]) -> list[Float]:
            a, b = (dr.gather(plain.Float, image, index) for image in (self._seen, self._own))
            by_seen = dr.fma(2 * a, sums[1], dr.fma(b, sums[2], sums[0]))
            sign = dr.select(a > b, self._by_distance, dr.select(a < b, -self._by_distance, 0))
            return [dr.fma(self._by_similarity, by_seen, sign) * dr.gather(plain.Float, self._slope, index)]

        rows = self._blurred(2, self._loaded(flow))
        return self._blurred(3, self._loaded(rows), finish)[0]

    def _blurred(self, number: int, load: Load, *finish: Finish) -> list[Float]:
        return blur(self._arrays, self._axes[number], self._sizes[number], load, *finish)

    def _loaded(self, maps: list[Float]) -> Load:
        Float = self._arrays.plain.Float
        return lambda index, inside: [dr.gather(Float, values, index, inside) for values in maps]

    def _zero_at(self, index: UInt) -> Float:
        return dr.gather(self._arrays.plain.Float, self._zero, index % CHANNELS)


class _Loss(torch.autograd.Function):
    """The bridge: torch holds the image, Dr.Jit computes loss and gradient."""

    @staticmethod
    def forward(  # type: ignore[override]  # the stub takes any
        ctx: Context, target: FrameTarget, rendered: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        loss, error, gradient = target.loss_and_gradient(rendered)
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(error)
        return loss, error

    @staticmethod
    @once_differentiable
    def backward(ctx: Context, by_loss: torch.Tensor, _: torch.Tensor) -> tuple[None, torch.Tensor]:
        (gradient,) = ctx.saved_tensors
        return None, gradient * by_loss


def _logarithmic(radiance: Float) -> tuple[Float, Float]:
    """The sRGB curve up to 1 and a logarithm above, so that lamps do not rule the loss; and its slope."""
    up_to_white = dr.minimum(radiance, 1)
    middle = dr.maximum(up_to_white, SRGB_DARK)
    power = dr.exp2(dr.log2(middle) * (1 / SRGB_GAMMA))
    above = dr.maximum(radiance, 1)
    curve = dr.fma(SRGB_SCALE, power, -SRGB_OFFSET)
    seen = dr.select(radiance > 1, dr.fma(_BRIGHT_SLOPE, dr.log(above), 1), curve)
    slope = _BRIGHT_SLOPE * dr.select(radiance > 1, dr.rcp(above), power * dr.rcp(middle))
    is_dark = radiance <= SRGB_DARK
    return dr.select(is_dark, SRGB_SLOPE * radiance, seen), dr.select(is_dark, SRGB_SLOPE, slope)
