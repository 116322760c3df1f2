"""How many Gaussians the surfaces and the detail of a scene ask for."""

from __future__ import annotations

from collections.abc import Mapping

from hybrid.plan.complexity import complexity_of
from hybrid.plan.decision import Decision, Value
from hybrid.plan.look import Look
from hybrid.plan.needs import Needs
from hybrid.plan.region import REGION
from pathtrace.region.region import NEAR

# Gaussians of the finest layer where nothing is known of a scene.
GAUSSIANS, FIXED_GAUSSIANS = "gaussians", 40_000
_ROUNDED = 100


def gaussians_decision(look: Look, breadth: float) -> Decision:
    """The number of Gaussians of the finest layer.

    Args:
        look: at the scene; its larger frames tell how much of them shows detail.
        breadth: how many times as many views as the default region the region takes.
    """
    complexity = complexity_of(look.denoised)
    needs = Needs.of(breadth, complexity)
    count = round(FIXED_GAUSSIANS * needs.gaussians / _ROUNDED) * _ROUNDED
    evidence = {"complexity": complexity, "breadth": breadth, "frames": len(look.denoised)}
    return Decision(GAUSSIANS, count, FIXED_GAUSSIANS, evidence, FIXED_GAUSSIANS / count, "Gaussians")


def planned_needs(plan: Mapping[str, Value], region: str, breadth: float) -> Needs:
    """What a region takes, as planned for it or for the default one; as `room` does if neither is planned.

    Args:
        plan: values by name; may be empty.
        region: as it was asked for.
        breadth: how many times as many views as the default region it takes.
    """
    if GAUSSIANS not in plan or plan[REGION] not in (region, NEAR):
        return Needs(breadth)
    share = int(plan[GAUSSIANS]) / FIXED_GAUSSIANS
    of_plan = Needs(breadth) if plan[REGION] == region else Needs()
    return Needs(breadth, share / of_plan.gaussians)
