"""The network's estimate from images of the parents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from compose.fusion.features import features_of
from compose.fusion.network import Fusion, mixture
from compose.fusion.parents import PARENTS, Parents


def estimated(
    fusion: Fusion, images: Mapping[str, Tensor], parents: Sequence[Parents]
) -> tuple[Tensor, Tensor]:
    """Radiance (N, 3, H, W) by the network alone, and the weights (N, 3, H, W) of the parents in it.

    Args:
        fusion: the network.
        images: parents, albedo, normal and count by name, (N, C, H, W) each, both sides even.
        parents: N, for what is the same in all pixels: enlargement and denoiser.
    """
    three = [images[name] for name in PARENTS]
    enlargement, quick = (
        three[0].new_tensor([float(getattr(one, name)) for one in parents])
        for name in ("enlargement", "quick")
    )
    auxiliary = images["albedo"], images["normal"]
    features = features_of([*three, *auxiliary], images["count"], enlargement, quick)
    return mixture(fusion(features), three, features.texture)
