"""Shadow rays, which may pass panes of thin glass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

# Surfaces that a shadow ray passes at most.
_MOST = 32


@dr.syntax
def transmittance(scene: Any, hit: Any, point: Any, active: Any) -> Any:
    """Share of light (Color3f) that comes to N places from points, through what lets it pass.

    Surfaces pass what their BSDF's null component does: thin glass, and the holes of masks.

    Args:
        scene: a Mitsuba scene.
        hit: N Mitsuba interactions.
        point: N points that light comes from.
        active: (N,) mask; 0 elsewhere.
    """
    share = dr.select(active, mi.Color3f(1), 0)
    going, passed, ray = mi.Bool(active), mi.UInt32(0), hit.spawn_ray_to(point)
    while dr.hint(going, exclude=[scene]):
        between = scene.ray_intersect(ray, mi.RayFlags.All, False, going)
        going &= between.is_valid()
        lets = between.bsdf().eval_null_transmission(between, going)
        # What comes after too many surfaces counts as hidden.
        share = dr.select(going, dr.select(passed < _MOST, share * lets, 0), share)
        going &= dr.max(share) > 0
        ray = dr.select(going, between.spawn_ray_to(point), ray)
        passed += 1
    return share
