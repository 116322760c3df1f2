"""What quality continuous levels of detail have, as a forest has learnt it from FovVideoVDP.

Perceptually guided 3D Gaussian splatting (sections 3.2, 3.3) learns levels from camera, gaze and quality.
Here nodes know what they make visible, so that views need not be learnt: what the nodes of a cut make
visible, weighted by where the viewer looks, gives the quality by a law of two numbers.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.render.frame_settings import BEST_JOD
from splat.model.forest import ABOUT, Forest

# Names of what is attached.
_VISIBILITY, _LAW = ABOUT + "levels.visibility", ABOUT + "levels.law"
# Degrees at which visible differences count half.
_HALVED = 3.0


@dataclass(frozen=True)
class LevelQuality:
    """The quality that a viewer of a display sees in cuts of a forest's hierarchy, against its leaves.

    It falls as more is visible, and what is visible counts less the farther it is from the gaze; so for a
    better quality, and nearer to the gaze, levels are never higher.

    Attributes:
        visibility: (M,) float32, what inner nodes make visible where their extent is one pixel.
        scale, exponent: what is visible per pixel, to the power of the exponent and times the scale, is what
            quality loses in JOD.
        display: for which that was learnt.
    """

    visibility: torch.Tensor
    scale: float
    exponent: float
    display: Display

    def jod(self, visible: float) -> float:
        """Quality where so much is visible per pixel."""
        return BEST_JOD - self.scale * visible**self.exponent

    def most(self, jod: float) -> float:
        """What may be visible per pixel for a quality."""
        if not self.scale:
            return math.inf
        return float(((BEST_JOD - jod) / self.scale) ** (1 / self.exponent))


def weights_at(eccentricity: NDArray[np.float32]) -> NDArray[np.float32]:
    """What visible differences count at angles from the gaze, in degrees."""
    return 1 / (1 + eccentricity / np.float32(_HALVED))


def attach_quality(forest: Forest, quality: LevelQuality | None) -> Forest:
    """The forest with the quality of its levels attached; with None, without that of earlier levels."""
    if quality is None:
        kept = {name: t for name, t in forest.attached.items() if name not in (_VISIBILITY, _LAW)}
        return replace(forest, attached=kept)
    law = torch.tensor([quality.scale, quality.exponent, *astuple(quality.display)], dtype=torch.float64)
    return replace(forest, attached=forest.attached | {_VISIBILITY: quality.visibility, _LAW: law})


def quality_of(forest: Forest) -> LevelQuality | None:
    """The quality that is attached to a forest; None if there is none, UserError if it is damaged."""
    visibility, law = (forest.attached.get(name) for name in (_VISIBILITY, _LAW))
    if visibility is None or law is None:
        return None
    inner = 0 if forest.hierarchy is None else len(forest.hierarchy)
    shapes = (law.dtype, law.shape, visibility.dtype, visibility.shape)
    if shapes == (torch.float64, (6,), torch.float32, (inner,)):
        scale, exponent, width, height, *rest = law.tolist()
        finite = bool(torch.isfinite(visibility).all() and torch.isfinite(law).all())
        if finite and scale >= 0 and exponent > 0 and bool((visibility >= 0).all()):
            return LevelQuality(visibility, scale, exponent, Display(round(width), round(height), *rest))
    raise UserError("the quality of the forest's levels is damaged; run hybrid levels again")
