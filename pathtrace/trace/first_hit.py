"""What rays hit first, continued through mirrors and clear glass, and the auxiliary features of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR, STILL, UNSTEADY
from pathtrace.scene.instances import AnyScene, seen_shapes

# Distance of the sky: beyond any scene, for its square is about the largest number that float32 holds. Seen
# from anywhere in the scene, it lies in the same direction.
SKY_DISTANCE = 1e18
# Random number that selects a BSDF's lobe: next to 1, a dielectric's transmission; a mirror has only one.
_LOBE_SAMPLE = 0.999
# Specular bounces that `first_hits` follows by default ...
_MAX_BOUNCES = 8
# ... and those of auxiliary features: an image hardly depends on what is left after more.
_AUXILIARY_BOUNCES = 4
# What a surface does to light that it does not let pass as it comes.
_SCATTERS = int(mi.BSDFFlags.All) & ~int(mi.BSDFFlags.Null)


@dataclass(frozen=True)
class FirstHits:
    """First hits of rays; Dr.Jit arrays, one entry per ray."""

    surface: mi.SurfaceInteraction3f  # interaction with the first surface; invalid where nothing is hit
    # That at the end of the path through mirrors and clear glass; invalid if that leaves the scene.
    last: mi.SurfaceInteraction3f
    unfolded: mi.Float  # length of this path; that of its part within the scene if it leaves the scene
    throughput: mi.Color3f  # share of light that mirrors and glass on the path pass on, per colour channel
    flat: mi.Bool  # whether all of them are flat mirrors: what those show appears to stand still behind them


@dataclass(frozen=True)
class AuxiliaryFeatures:
    """Features that denoising and fusion use, of N film positions or rays; linear Dr.Jit floats."""

    albedo: list[mi.Float]  # three (N,) arrays; 0 for the sky
    normal: list[mi.Float]  # three (N,) arrays, shading normal in world space; 0 for the sky
    # Three (N,) arrays, apparent position in the world of what is seen: on the surface that is hit, or
    # behind a flat mirror.
    position: list[mi.Float]
    gloss: mi.Float  # (N,) class of gloss of what is seen: DIFFUSE, GLOSSY or SPECULAR
    # (N,) its number among what moves (compose.base.traced_samples); None where nothing does.
    mover: mi.Float | None = None

    @property
    def of_first(self) -> list[Any]:
        """The channels that several samples have from the first of them."""
        return [*self.position, self.gloss, *([] if self.mover is None else [self.mover])]

    def averaged(self, other: AuxiliaryFeatures, share: float) -> AuxiliaryFeatures:
        """These features, with albedo and normal averaged over those of other samples with a share."""
        albedo, normal = (
            [dr.lerp(a, b, share) for a, b in zip(getattr(self, name), getattr(other, name), strict=True)]
            for name in ("albedo", "normal")
        )
        return replace(self, albedo=albedo, normal=normal)


@dataclass(frozen=True)
class Unseen:
    """What rays of a camera pass as if it were not there: area lights, and boundaries that pass all light."""

    lights: bool
    boundaries: bool

    @staticmethod
    def of(scene: mi.Scene, lights: bool) -> Unseen | None:
        """Those of a Mitsuba scene, with or without its lights; None if there are none."""
        boundaries = any(not int(shape.bsdf().flags()) & _SCATTERS for shape in seen_shapes(scene))
        return Unseen(lights, boundaries) if lights or boundaries else None

    def holds(self, scene: AnyScene, surface: mi.SurfaceInteraction3f) -> mi.Bool:
        """Mask of the interactions (N,) with such surfaces."""
        found = mi.Bool(False)
        if self.lights:
            found |= surface.emitter(scene) != None  # noqa: E711
        if self.boundaries:
            found |= surface.bsdf().flags() & _SCATTERS == 0
        return found & surface.is_valid()


def has_clear_surfaces(scene: mi.Scene) -> bool:
    """Whether a Mitsuba scene has mirrors or clear glass."""
    return any(not mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth) for shape in seen_shapes(scene))


def first_hits(
    scene: AnyScene,
    ray: mi.Ray3f,
    active: mi.Bool,
    bounces: int = _MAX_BOUNCES,
    unseen: Unseen | None = None,
) -> FirstHits:
    """Follows N Mitsuba rays through mirrors and clear glass, at most so many, to the first other surface.

    What is unseen is passed.
    """
    flags = mi.RayFlags.All | mi.RayFlags.dNSdUV if bounces else mi.RayFlags.All
    # Coherent rays: Embree follows those of neighbouring pixels together, four times as fast.
    surface = scene.ray_intersect(ray, flags, True, active)
    if unseen is not None:
        surface = _beyond(scene, surface, ray.d, active, unseen, flags)
    if not bounces:
        return FirstHits(surface, surface, mi.Float(surface.t), mi.Color3f(1), mi.Bool(True))
    return _followed(scene, surface, active & surface.is_valid(), flags, bounces)


@dr.syntax
def _beyond(
    scene: AnyScene,
    surface: mi.SurfaceInteraction3f,
    way: mi.Vector3f,
    active: mi.Bool,
    unseen: Unseen,
    flags: int,
) -> mi.SurfaceInteraction3f:
    """Follows N rays along their way past unseen surfaces; `flags` say what hits must know."""
    surface = mi.SurfaceInteraction3f(surface)
    passing = active & unseen.holds(scene, surface)
    while dr.hint(passing, exclude=[way, unseen]):
        onward = scene.ray_intersect(surface.spawn_ray(way), flags, False, passing)
        onward.t += surface.t
        surface = dr.select(passing, onward, surface)
        passing &= unseen.holds(scene, surface)
    return surface


@dr.syntax
def _followed(
    scene: AnyScene,
    surface: mi.SurfaceInteraction3f,
    alive: mi.Bool,
    flags: int,
    bounces: int,
) -> FirstHits:
    """Follows rays that hit a surface; `alive` (N,) is the mask of those, `flags` say what hits must know."""
    last = mi.SurfaceInteraction3f(surface)
    unfolded, throughput, flat = mi.Float(surface.t), mi.Color3f(1), mi.Bool(True)
    bounce = mi.UInt32(0)
    while dr.hint(alive & (bounce < bounces), exclude=[surface]):
        bsdf = last.bsdf()
        kinds = bsdf.flags()
        clear = alive & ~mi.has_flag(kinds, mi.BSDFFlags.Smooth)
        sample, weight = bsdf.sample(mi.BSDFContext(), last, _LOBE_SAMPLE, mi.Point2f(0.5), clear)
        clear &= dr.max(weight) > 0
        onward = scene.ray_intersect(last.spawn_ray(last.to_world(sample.wo)), flags, False, clear)
        is_plane = dr.squared_norm(last.dn_du) + dr.squared_norm(last.dn_dv) == 0
        flat_mirror = is_plane & ~mi.has_flag(kinds, mi.BSDFFlags.Transmission)
        flat &= dr.select(clear, flat_mirror, True)
        throughput = dr.select(clear, throughput * weight, throughput)
        alive = clear & onward.is_valid()
        unfolded = dr.select(alive, unfolded + onward.t, unfolded)
        last = dr.select(clear, onward, last)
        bounce += 1
    return FirstHits(surface, last, unfolded, throughput, flat)


def auxiliary_hits(
    scene: AnyScene,
    ray: mi.Ray3f,
    active: mi.Bool,
    clear: bool,
    unseen: Unseen | None = None,
) -> FirstHits:
    """First hits as `auxiliary_features` requires them; `clear` if there are mirrors or clear glass."""
    return first_hits(scene, ray, active, _AUXILIARY_BOUNCES if clear else 0, unseen)


def auxiliary_features(
    hits: FirstHits, ray: mi.Ray3f, active: mi.Bool, movers: Sequence[tuple[int, int]] = ()
) -> AuxiliaryFeatures:
    """Auxiliary features of what rays see, without antialiasing, also in mirrors and behind clear glass.

    Movers are the numbers by which kernels know a shape that moves, and those that samples of it have.
    """
    hit, last = active & hits.surface.is_valid(), hits.last
    shown = active & last.is_valid()
    albedo = hits.throughput * last.bsdf(ray).eval_diffuse_reflectance(last, shown)
    # What is refracted, or seen in a curved mirror, moves with the viewer: its position is that of the glass.
    position = ray(dr.select(hits.flat, hits.unfolded, hits.surface.t))
    position = dr.select(hit & (shown | ~hits.flat), position, ray(SKY_DISTANCE))
    kinds = last.bsdf(ray).flags()
    delta, glossy = (mi.has_flag(kinds, kind) for kind in (mi.BSDFFlags.Delta, mi.BSDFFlags.Glossy))
    gloss = dr.select(delta, SPECULAR, dr.select(glossy, GLOSSY, mi.Float(DIFFUSE)))
    gloss = dr.select(hit & ~hits.flat, SPECULAR, dr.select(shown, gloss, DIFFUSE))
    mean = list(dr.select(shown, albedo, 0)), list(dr.select(shown, last.sh_frame.n, 0))
    return AuxiliaryFeatures(*mean, list(position), gloss, _mover(hits, hit, shown, movers))


def _mover(
    hits: FirstHits, hit: mi.Bool, shown: mi.Bool, movers: Sequence[tuple[int, int]]
) -> mi.Float | None:
    """What is seen among what moves, where rays hit anything, and end on a surface; None if nothing moves."""
    if not movers:
        return None
    shape, number = dr.reinterpret_array(mi.UInt32, hits.surface.shape), mi.Float(STILL)
    for registered, mover in movers:
        number = dr.select(shape == registered, mi.Float(mover), number)
    # In mirrors and behind glass, it is not the surface itself that is seen.
    itself = shown & (hits.unfolded == hits.surface.t)
    return dr.select(hit, dr.select(itself, number, mi.Float(UNSTEADY)), mi.Float(STILL))


# Optical depth at which half of the light of what lies behind is left.
_HALF = math.log(2)
# Share of the light below which what lies behind is hidden.
_HIDDEN = 0.05
# Steps at which a medium is looked at between two surfaces, and how far into one that never ends, in sizes of
# the scene.
_STEPS, _REACH = 32, 4.0


@dataclass(frozen=True)
class Veil:
    """What media do to what N rays see behind them."""

    # (N,) distance along the ray at which half of the light is left, where hardly any arrives; inf where
    # what lies behind is still seen.
    half: mi.Float
    transmittance: mi.Float  # (N,) share of the light that arrives, mean over the channels
    albedo: mi.Color3f  # (N,) colours, of scattering, by the share of the light that is scattered on the way

    def over(self, features: AuxiliaryFeatures, ray: mi.Ray3f) -> AuxiliaryFeatures:
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
def veil(scene: AnyScene, ray: mi.Ray3f, medium: mi.Medium | None, active: mi.Bool) -> Veil:
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
def _crossed(
    medium: mi.MediumPtr,
    start: mi.Point3f,
    way: mi.Vector3f,
    step: mi.Float,
    depth: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Float, mi.Float, mi.Color3f]:
    """Follows N rays through a medium for _STEPS steps, which are their way each, of length `step`.

    Returns the optical depth from then on; after how many steps it was half, else _STEPS; and the albedo by
    the share of the light that is scattered.
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
