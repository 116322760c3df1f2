"""Views whose radiance is known, from which the fusion learns and on which it proves itself."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from compose.fusion.channels import Channels
from compose.fusion.maps import as_batch
from compose.fusion.parents import PARENTS, Parents
from compose.fusion.reference import Reference

# All images of an example, stacked in one tensor so that patches are cut from all of them at once. Target and
# noise are those of `Reference.targets`.
STACK = Channels(
    {"traced": 3, "denoised": 3, "splat": 3, "albedo": 3, "normal": 3, "target": 3, "noise": 3, "count": 1}
)


@dataclass(frozen=True)
class Example:
    """A view whose radiance is known up to noise.

    Attributes:
        parents: as a fovea would have them.
        reference: independent of the parents' samples.
        view: number of the view; close-ups of one view have the same number.
    """

    parents: Parents
    reference: Reference
    view: int

    def stack(self) -> Tensor:
        """(STACK.total, H, W) of all images."""
        names = (*PARENTS, "albedo", "normal", "count")
        images = {name: as_batch(getattr(self.parents, name))[0] for name in names}
        target, noise = self.reference.targets()
        return STACK.stacked({**images, "target": target, "noise": noise})
