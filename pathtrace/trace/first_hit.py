"""What a ray sees: the first surface, or what mirrors and clear glass show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

# Where nothing is hit, the sky is this far away.
FAR = 1e5
MATT, GLOSSY, SPECULAR = 0, 1, 2
_MOST_BOUNCES = 8
# Of a frame's rays: the picture hardly depends on what is left after so many.
_BOUNCES = 4


@dataclass(frozen=True)
class Sight:
    """What rays see; Dr.Jit arrays, one entry per ray.

    Attributes:
        surface: the first interaction; invalid where nothing is hit.
        last: where mirrors and glass have led to.
        unfolded: length of the way there; that of the first hit where it leads out of the scene.
        tint: what mirrors and glass on the way leave of the light.
        plain: whether only flat mirrors were on the way: what they show seems to stand still behind them.
    """

    surface: Any
    last: Any
    unfolded: Any
    tint: Any
    plain: Any


def has_clear_surfaces(scene: Any) -> bool:
    """Whether a scene has mirrors or clear glass."""
    return any(not mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth) for shape in scene.shapes())


def look(scene: Any, ray: Any, active: Any, bounces: int = _MOST_BOUNCES) -> Sight:
    """Follows rays to the first surface that is not clear, through at most so many that are."""
    flags = mi.RayFlags.All | mi.RayFlags.dNSdUV if bounces else mi.RayFlags.All
    # Rays of neighbouring pixels side by side: Embree follows them together, four times as fast.
    surface = scene.ray_intersect(ray, flags, True, active)
    valid = surface.is_valid()
    last, alive = surface, active & valid
    unfolded, tint, plain = mi.Float(surface.t), mi.Color3f(1), mi.Bool(True)
    for _ in range(bounces):
        bsdf = last.bsdf()
        kinds = bsdf.flags()
        clear = alive & ~mi.has_flag(kinds, mi.BSDFFlags.Smooth)
        # A first sample next to 1 takes a dielectric's transmission, a mirror has one lobe only.
        sample, weight = bsdf.sample(mi.BSDFContext(), last, 0.999, mi.Point2f(0.5), clear)
        clear &= dr.max(weight) > 0
        onward = scene.ray_intersect(last.spawn_ray(last.to_world(sample.wo)), flags, False, clear)
        flat = dr.squared_norm(last.dn_du) + dr.squared_norm(last.dn_dv) == 0
        mirror = flat & ~mi.has_flag(kinds, mi.BSDFFlags.Transmission)
        plain &= dr.select(clear, mirror, True)
        tint = dr.select(clear, tint * weight, tint)
        alive = clear & onward.is_valid()
        unfolded = dr.select(alive, unfolded + onward.t, unfolded)
        last = dr.select(clear, onward, last)
    return Sight(surface, last, unfolded, tint, plain)


def auxiliary(scene: Any, ray: Any, active: Any, clear: bool) -> list[Any]:
    """Albedo, normal, the place in the world where what rays see seems to be, and its gloss.

    Behind mirrors and clear glass, albedo and normal are those of what they show: denoising needs them there.

    Args:
        scene: a Mitsuba scene.
        ray, active: what looks.
        clear: whether the scene has mirrors or clear glass at all.

    Returns:
        Ten channels: three each, 0 where that is the sky, and MATT, GLOSSY or SPECULAR.
    """
    sight = look(scene, ray, active, _BOUNCES if clear else 0)
    hit, last = active & sight.surface.is_valid(), sight.last
    shown = active & last.is_valid()
    albedo = sight.tint * last.bsdf(ray).eval_diffuse_reflectance(last, shown)
    # What is bent, or mirrored by something round, does not stand still: there, the glass is the place.
    place = ray(dr.select(sight.plain, sight.unfolded, sight.surface.t))
    place = dr.select(hit & (shown | ~sight.plain), place, ray(FAR))
    kinds = last.bsdf(ray).flags()
    delta, glossy = (mi.has_flag(kinds, kind) for kind in (mi.BSDFFlags.Delta, mi.BSDFFlags.Glossy))
    gloss = dr.select(delta, SPECULAR, dr.select(glossy, GLOSSY, mi.Float(MATT)))
    gloss = dr.select(hit & ~sight.plain, SPECULAR, dr.select(shown, gloss, MATT))
    return [*dr.select(shown, albedo, 0), *dr.select(shown, last.sh_frame.n, 0), *place, gloss]
