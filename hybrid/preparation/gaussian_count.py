"""How many Gaussians a scene takes, by the detail of its frames and the breadth of its region."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance
from hybrid.preparation.decisions import REGION, Decision, Value
from hybrid.preparation.scene_look import Look
from hybrid.preparation.stages import Needs
from pathtrace.region.view_coverage import ViewCoverage
from pathtrace.region.viewing_regions import NEAR, ViewingRegion
from pathtrace.scene.triangles import Surfaces

# Deviation from the mean of a group of pixels, in sRGB values, from which on the group shows detail: at
# less, a Gaussian that covers all of it is close enough.
_VISIBLE = 1 / 32
# Side in pixels of a group.
GROUP = 2
# Share of the groups that show detail in the first frames of `room`.
_ORDINARY_SHARE = 0.46


def complexity_of(frames: Iterable[Image]) -> float:
    """Share of frames (H, W, 3) that shows edges and texture, over that of `room`; for `Needs.of`."""
    return float(np.mean([detailed(frame).mean() for frame in frames]) / _ORDINARY_SHARE)


def detailed(radiance: Image) -> NDArray[np.bool_]:
    """Which groups of GROUP x GROUP pixels of a frame show detail."""
    height, width = (side // GROUP * GROUP for side in radiance.shape[:2])
    image = srgb_from_radiance(radiance[:height, :width])
    groups = image.reshape(height // GROUP, GROUP, width // GROUP, GROUP, 3)
    deviation = np.abs(groups - groups.mean(axis=(1, 3), keepdims=True)).max(axis=(1, 3, 4))
    return np.asarray(deviation > _VISIBLE)


# Gaussians of the finest layer where nothing is known of a scene.
GAUSSIANS, FIXED_GAUSSIANS = "gaussians", 40_000
_ROUNDED = 100


def gaussians_decision(look: Look, breadth: float) -> Decision:
    """The number of Gaussians of the finest layer, for a region of some breadth (`breadth_of`)."""
    complexity = complexity_of(look.denoised)
    needs = Needs.of(breadth, complexity)
    count = round(FIXED_GAUSSIANS * needs.gaussians / _ROUNDED) * _ROUNDED
    evidence = {"complexity": complexity, "breadth": breadth, "frames": len(look.denoised)}
    return Decision(GAUSSIANS, count, FIXED_GAUSSIANS, evidence, FIXED_GAUSSIANS / count, "Gaussians")


def planned_needs(plan: Mapping[str, Value], region: str, breadth: float) -> Needs:
    """What a region takes, as planned for it or for the default one; as `room` does if neither is planned.

    The plan, values by name, may be empty; `region` is as it was asked for, `breadth` that of `breadth_of`.
    """
    if GAUSSIANS not in plan or plan[REGION] not in (region, NEAR):
        return Needs(breadth)
    share = int(plan[GAUSSIANS]) / FIXED_GAUSSIANS
    of_plan = Needs(breadth) if plan[REGION] == region else Needs()
    return Needs(breadth, share / of_plan.gaussians)


# Side in pixels of views that tell it.
_BREADTH_SIDE = 256
# Views that the default region takes at first; how many that see enough is tried in these numbers.
_ORDINARY_VIEWS, _TRIED = 32, (32, 48, 64, 96, 128, 192, 256, 384)
_ENOUGH = 0.95
_ASKERS = 24


def breadth_of(region: ViewingRegion, surfaces: Surfaces, seed: int) -> float:
    """How many times as many views as the default region a region takes until little is unseen; 1 to 12."""
    if region.name == "near":
        return 1.0
    views = region.views(_TRIED[-1], _BREADTH_SIDE, _BREADTH_SIDE, seed)
    askers = region.unseen_views(_ASKERS, _BREADTH_SIDE, _BREADTH_SIDE, seed + 1)
    coverage, before = ViewCoverage(surfaces, []), 0
    for count in _TRIED:
        coverage.add(views[before:count])
        before = count
        if np.mean([coverage.share(view) for view in askers]) >= _ENOUGH:
            break
    return before / _ORDINARY_VIEWS
