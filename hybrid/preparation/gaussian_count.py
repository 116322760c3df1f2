"""How many Gaussians a scene takes, by what a look at its surfaces shows and the breadth of its region."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hybrid.preparation.decisions import REGION, Decision, Value
from hybrid.preparation.scene_look import Look
from hybrid.preparation.stages import Needs
from pathtrace.region import NEAR, ViewingRegion
from pathtrace.region.view_coverage import ViewCoverage
from pathtrace.scene.triangles import Surfaces
from splat.training.clusters import HitTree
from splat.training.initialization import hits_of
from splat.training.training_view import place_of, placed

# Squared differences of colours on the perceptual scale, summed over the pixels of a frame, above which a
# part of a surface is more than one Gaussian in its mean colour should stand for.
_VISIBLE = 1 / 32
# Gaussians for each such part that the look has seen, which misses some of what all training views show. In
# a minute on two cores, 4 instead of 2.5 gain 0.2 to 1.8 dB on `room`, foliage and cluttered rooms, and lose
# up to 0.3 dB on thin trusses and `staircase2`. Where something moves, a step takes the longer the more there
# are: there, 4 lose 0.6 dB in three minutes.
_PER_PART, _PER_MOVING_PART = 4.0, 2.5
# Numbers for which the plan says what they would leave.
_TRIED_COUNTS = (10_000, 30_000, 100_000, 300_000)

# Gaussians of the finest layer where nothing is known of a scene.
GAUSSIANS, FIXED_GAUSSIANS = "gaussians", 40_000
_ROUNDED = 100


def gaussians_decision(look: Look, breadth: float, moves: bool = False) -> Decision:
    """The number of Gaussians of the finest layer, for a region of some breadth (`breadth_of`).

    Its evidence has the dB that frames would have if as many Gaussians each had one colour (`error_db`), of a
    look's few frames: how fast that rises tells what more Gaussians would bring.
    """
    parts, curve, each = 1, {}, _PER_MOVING_PART if moves else _PER_PART
    if any(len(view.surface_pixels) for view in look.shown):
        place = place_of(look.shown)
        tree = HitTree(hits_of([placed(view, place) for view in look.shown]))
        parts = tree.count_of(_VISIBLE * len(look.shown))
        curve = {str(count): tree.psnr_of(round(count / each)) for count in _TRIED_COUNTS}
    needs = Needs(breadth, parts * each / FIXED_GAUSSIANS)
    count = max(_ROUNDED, round(FIXED_GAUSSIANS * needs.gaussians / _ROUNDED) * _ROUNDED)
    evidence = {"parts": parts, "breadth": breadth, "frames": len(look.shown), "error_db": curve}
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
