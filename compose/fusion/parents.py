"""What is fused, and the result."""

from __future__ import annotations

from dataclasses import dataclass, fields

from compose.image.colour import Image

# Parents, in the order of their weights.
PARENTS = ("traced", "denoised", "splat")


@dataclass(frozen=True)
class Parents:
    """What is known of one picture.

    Attributes:
        traced: (H, W, 3) mean of the path-traced samples, linear radiance.
        variance: (H, W, 3) of that mean; inf where it is not known.
        denoised: (H, W, 3) the same samples, denoised.
        splat: (H, W, 3) the splats' picture of the same view.
        albedo, normal: (H, W, 3) of the same samples.
        count: (H, W, 1) how many samples.
        enlargement: side of the pixels that the splats were trained on, in pixels of this picture.
        quickly_denoised: whether by the quicker denoiser, though there may be many samples.
    """

    traced: Image
    variance: Image
    denoised: Image
    splat: Image
    albedo: Image
    normal: Image
    count: Image
    enlargement: float
    quick: bool = False

    def __post_init__(self) -> None:
        for field in fields(self)[:-2]:
            shape = getattr(self, field.name).shape
            expected = (*self.traced.shape[:2], 1 if field.name == "count" else 3)
            if shape != expected:
                raise ValueError(f"{field.name} is {shape}, must be {expected} as traced is")


@dataclass(frozen=True)
class Fused:
    """One estimate of radiance.

    Attributes:
        radiance: (H, W, 3) linear.
        weights: (H, W, 3) share of each parent, in the order of PARENTS.
        excluded: pixels in which a parent was not finite or negative, and left out.
    """

    radiance: Image
    weights: Image
    excluded: int
