"""How participating media veil what lies behind them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from compose.base.traced_samples import DIFFUSE
from pathtrace.trace.first_hit import AuxiliaryFeatures, Unseen

# Optical depth at which half of the light of what lies behind is left.
_HALF = math.log(2)
# Share of the light below which what lies behind is hidden.
_HIDDEN = 0.05
# Steps at which a medium is looked at between two surfaces, and how far into one that never ends, in sizes of
# the scene.
_STEPS, _REACH = 32, 4.0


@dataclass(frozen=True)
class Veil:
    """What media do to what N rays see behind them.

    Attributes:
        half: (N,) distance along the ray at which half of the light is left, where hardly any arrives; inf
            where what lies behind is still seen.
        transmittance: (N,) share of the light that arrives, mean over the channels.
        albedo: (N,) colours, of scattering, by the share of the light that is scattered on the way.
    """

    half: Any
    transmittance: Any
    albedo: Any

    def over(self, features: AuxiliaryFeatures, ray: Any) -> AuxiliaryFeatures:
        """Auxiliary features of N rays, mixed with those of media, which are matt and face the ray."""
        hides, left = dr.isfinite(self.half), self.transmittance
        pairs = zip(features.albedo, self.albedo, strict=True)
        albedo = [dr.fma(left, behind, own) for behind, own in pairs]
        normal = [dr.lerp(-way, n, left) for way, n in zip(ray.d, features.normal, strict=True)]
        at = zip(ray(self.half), features.position, strict=True)
        position = [dr.select(hides, own, behind) for own, behind in at]
        gloss = dr.select(hides, mi.Float(DIFFUSE), features.gloss)
        return replace(features, albedo=albedo, normal=normal, position=position, gloss=gloss)


@dr.syntax
def veil(scene: Any, ray: Any, medium: Any, active: Any) -> Veil:
    """The veil of a Mitsuba scene's media before N rays; `medium` is that in which they start, or None."""
    box = scene.bbox()
    reach, boundaries = _REACH * dr.norm(box.max - box.min), Unseen(lights=False, boundaries=True)
    start, way, passed = mi.Point3f(ray.o), mi.Vector3f(ray.d), mi.Float(0)
    going, inside = mi.Bool(active), dr.select(active, mi.MediumPtr(medium), None)
    depth, half, albedo = mi.Float(0), mi.Float(dr.inf), mi.Color3f(0)
    while dr.hint(going, exclude=[way, reach, boundaries]):
        hit = scene.ray_intersect(mi.Ray3f(start, way), mi.RayFlags.All, False, going)
        step = dr.minimum(hit.t, reach) / _STEPS
        depth, steps, added = _crossed(inside, start, way * step, step, depth, going)
        # An endless medium has the sky behind it, which is as far away.
        half = dr.select(going & hit.is_valid() & (steps < _STEPS), passed + step * steps, half)
        albedo += added
        going &= boundaries.holds(scene, hit)
        inside = dr.select(going & hit.is_medium_transition(), hit.target_medium(way), inside)
        passed += hit.t
        start = hit.spawn_ray(way).o
    left = dr.exp(-depth)
    return Veil(dr.select(left < _HIDDEN, half, dr.inf), left, albedo)


@dr.syntax
def _crossed(medium: Any, start: Any, way: Any, step: Any, depth: Any, active: Any) -> Any:
    """Follows N rays through a medium for _STEPS steps, which are their way each, of length `step`.

    Returns the optical depth from then on; after how many steps it was half, _STEPS where that is not within;
    and the albedo by the share of the light that is scattered.
    """
    depth, steps, albedo = mi.Float(depth), mi.Float(_STEPS), mi.Color3f(0)
    going, number = active & (medium != None), mi.Float(0)  # noqa: E711
    while dr.hint(going & (number < _STEPS), exclude=[medium, way, step, going]):
        at = dr.zeros(mi.MediumInteraction3f, dr.width(start))
        at.p = start + way * (number + 0.5)
        scattered, _, extinction = medium.get_scattering_coefficients(at, going)
        behind = depth + dr.mean(extinction) * step
        crosses = (depth < _HALF) & (behind >= _HALF)
        steps = dr.select(crosses, number + (_HALF - depth) / (behind - depth), steps)
        shares = scattered / dr.maximum(extinction, 1e-20)
        albedo += shares * (dr.exp(-depth) - dr.exp(-behind))
        depth = behind
        number += 1
    return depth, steps, albedo
