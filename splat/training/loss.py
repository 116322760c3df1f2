"""The training loss, with the structural similarity in it.

Value and gradient come out of the same kernels: of a loss that is computed at every step, both are needed.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import torch
from torch.autograd.function import once_differentiable

from compose.base.arrays import Arrays
from splat.training.window import CHANNELS, TAPS, across, blur, down, transposed

# Smaller images do not hold the similarity's window.
SMALLEST_SIDE = TAPS
_C1, _C2 = 0.01**2, 0.03**2
SSIM_WEIGHT = 0.2
# The sRGB curve: where its straight part ends, and that part's slope.
_STRAIGHT, _SLOPE = 0.0031308, 12.92
_BRIGHT_SLOPE = 1.055 / 2.4


class Target:
    """A frame to match.

    What depends on the frame alone is computed again each time: kept, it would take three times the memory of
    the frame, of every frame of a training, and save a fiftieth of a step.

    Args:
        arrays: the backend's array types, on whose device the loss is computed.
        radiance: (H, W, 3) linear, float32 or float16, both sides at least 11 pixels; kept, not copied.
    """

    def __init__(self, arrays: Arrays, radiance: torch.Tensor):
        self._arrays, self._radiance = arrays, radiance
        self._height, self._width = radiance.shape[:2]
        seen, _ = _logarithmic(self._frame())
        # Variances do not depend on where zero is. With zero amid the frame's own values, little cancels in
        # them; where all is very bright, rounding would otherwise exceed the similarity's constants.
        means = arrays.to_torch(seen, torch.device("cpu")).reshape(-1, CHANNELS).double().mean(dim=0)
        self._zero = arrays.plain.Float(means.float().numpy())

    def loss(self, rendered: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(1 - w) L1 + w (1 - SSIM), on a scale for lamps beside shadows (Fov-GS Eq. 4).

        Args:
            rendered: (H, W, 3) float32, linear radiance.

        Returns:
            The loss, and the absolute error per pixel (H, W), which has no gradient.
        """
        loss, error = _Loss.apply(self, rendered)
        return loss, error

    def loss_and_gradient(self, rendered: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Loss, error per pixel (H, W), and the derivative of the loss by the radiance (H, W, 3)."""
        zero = self._zero_at(dr.arange(self._arrays.plain.UInt, rendered.numel()))
        seen, slope = _logarithmic(_flat(self._arrays, rendered))
        own, _ = _logarithmic(self._frame())
        seen, own = seen - zero, own - zero
        distance = dr.abs(seen - own)
        dr.eval(seen, own, slope, distance)
        error = dr.block_sum(distance, CHANNELS) / CHANNELS
        dissimilarity, *flow = self._compared(seen, own)
        # Means of as many numbers as there are.
        by_distance = (1 - SSIM_WEIGHT) / dr.width(seen)
        by_similarity = -SSIM_WEIGHT / dr.width(dissimilarity)
        gradient = self._gradient(flow, seen, own, slope, by_distance, by_similarity)
        loss = by_distance * dr.sum(distance) - by_similarity * dr.sum(dissimilarity)
        dr.eval(error, loss)
        there = lambda array: self._arrays.to_torch(array, rendered.device)  # noqa: E731
        return (
            there(loss)[0],
            there(error).reshape(rendered.shape[:2]),
            there(gradient).reshape(rendered.shape),
        )

    def _frame(self) -> Any:
        """The frame's radiance, flat."""
        return _flat(self._arrays, self._radiance.float())

    def _compared(self, seen: Any, own: Any) -> list[Any]:
        """Per window 1 - SSIM, and SSIM's derivatives by the means of an image, its square and its product.

        Args:
            seen: the image.
            own: the frame, and the other factor of the product.
        """
        Float = self._arrays.plain.Float

        def load(index: Any, inside: Any) -> list[Any]:
            a, b = dr.gather(Float, seen, index, inside), dr.gather(Float, own, index, inside)
            return [a, a * a, a * b, b, b * b]

        def finish(index: Any, means: list[Any]) -> list[Any]:
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

        width, height = self._width, self._height
        rows = blur(self._arrays, across(width, height), load)
        return blur(self._arrays, down(width - TAPS + 1, height), self._loaded(rows), finish)

    def _gradient(
        self, flow: list[Any], seen: Any, own: Any, slope: Any, by_distance: float, by_similarity: float
    ) -> Any:
        """Derivative of the loss by the radiance from SSIM's derivatives by the means of `_compared`."""
        arrays, width, height = self._arrays, self._width, self._height
        Float, shares = (
            arrays.plain.Float,
            [dr.opaque(arrays.plain.Float, v) for v in (by_distance, by_similarity)],
        )

        def finish(index: Any, sums: list[Any]) -> list[Any]:
            a, b = dr.gather(Float, seen, index), dr.gather(Float, own, index)
            by_seen = dr.fma(2 * a, sums[1], dr.fma(b, sums[2], sums[0]))
            sign = dr.select(a > b, shares[0], dr.select(a < b, -shares[0], 0))
            return [dr.fma(shares[1], by_seen, sign) * dr.gather(Float, slope, index)]

        rows = blur(arrays, transposed(down(width - TAPS + 1, height)), self._loaded(flow))
        return blur(arrays, transposed(across(width, height)), self._loaded(rows), finish)[0]

    def _loaded(self, maps: list[Any]) -> Any:
        Float = self._arrays.plain.Float
        return lambda index, inside: [dr.gather(Float, values, index, inside) for values in maps]

    def _zero_at(self, index: Any) -> Any:
        return dr.gather(self._arrays.plain.Float, self._zero, index % CHANNELS)


class _Loss(torch.autograd.Function):
    """The bridge: torch holds the image, Dr.Jit computes loss and gradient."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, target: Target, rendered: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        loss, error, gradient = target.loss_and_gradient(rendered)
        ctx.save_for_backward(gradient)
        ctx.mark_non_differentiable(error)
        return loss, error

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_loss: torch.Tensor, _: torch.Tensor) -> tuple[None, torch.Tensor]:
        (gradient,) = ctx.saved_tensors
        return None, gradient * by_loss


def _flat(arrays: Arrays, image: torch.Tensor) -> Any:
    return dr.detach(arrays.from_torch(image), preserve_type=False)


def _logarithmic(radiance: Any) -> tuple[Any, Any]:
    """The sRGB curve up to 1 and a logarithm above, so that lamps do not rule the loss; and its slope."""
    middle = dr.maximum(dr.minimum(radiance, 1), _STRAIGHT)
    power = dr.exp2(dr.log2(middle) * (1 / 2.4))
    above = dr.maximum(radiance, 1)
    seen = dr.select(radiance > 1, dr.fma(_BRIGHT_SLOPE, dr.log(above), 1), dr.fma(1.055, power, -0.055))
    slope = _BRIGHT_SLOPE * dr.select(radiance > 1, dr.rcp(above), power * dr.rcp(middle))
    is_dark = radiance <= _STRAIGHT
    return dr.select(is_dark, _SLOPE * radiance, seen), dr.select(is_dark, _SLOPE, slope)
