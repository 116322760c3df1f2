"""Where viewers may be, and how much of a scene that shows."""

from __future__ import annotations

from hybrid.plan.decision import Decision
from hybrid.plan.look import Look
from pathtrace.region.region import NEAR

REGION = "region"


def region_decision(region: str, look: Look, breadth: float) -> Decision:
    """Where viewers are; they decide, and frames and Gaussians follow.

    Args:
        region: as it was asked for.
        look: at the scene from there.
        breadth: how many times as many views as the default region the region takes.
    """
    evidence = {"parallax": look.parallax, "is_one_point": look.is_one_point, "breadth": breadth}
    return Decision(REGION, region, NEAR, evidence, 1 / breadth, "views to train on")
