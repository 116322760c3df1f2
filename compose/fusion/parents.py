"""What is fused, and the result."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from compose.image.colour import Image

# Parents, in the order of their weights.
PARENTS = ("traced", "denoised", "splat")


@dataclass(frozen=True)
class Parents:
    """Images of one view from which its radiance is estimated, all of NumPy or all of torch on one device.

    Attributes:
        traced: (H, W, 3) mean of the path-traced samples, linear radiance.
        variance: (H, W, 3) of that mean; inf where it is unknown.
        denoised: (H, W, 3) the same samples, denoised.
        splat: (H, W, 3) the splats, rendered for the same view.
        albedo, normal: (H, W, 3) auxiliary features of the same samples.
        count: (H, W, 1) number of samples.
        enlargement: side of the pixels that the splats were trained on, in pixels of these images.
        quick: whether the quicker denoiser was used.

    Raises:
        ValueError: the shapes do not match.
    """

    traced: Image | Tensor
    variance: Image | Tensor
    denoised: Image | Tensor
    splat: Image | Tensor
    albedo: Image | Tensor
    normal: Image | Tensor
    count: Image | Tensor
    enlargement: float
    quick: bool = False

    def __post_init__(self) -> None:
        size = self.traced.shape[:2]
        for name in ("traced", "variance", "denoised", "splat", "albedo", "normal", "count"):
            shape = tuple(getattr(self, name).shape)
            expected = (*size, 1 if name == "count" else 3)
            if shape != expected:
                raise ValueError(f"{name} is {shape}, must be {expected} to match traced")


@dataclass(frozen=True)
class Fused:
    """One estimate of radiance, of torch, where the parents are.

    Attributes:
        radiance: (H, W, 3) linear.
        weights: (H, W, 3) of the parents, in the order of PARENTS.
        excluded: number of pixels in which a parent was left out because it was negative, not finite, or out
            of proportion to its neighbours and to the other parents (compose.image.outliers).
    """

    radiance: Tensor
    weights: Tensor
    excluded: int
