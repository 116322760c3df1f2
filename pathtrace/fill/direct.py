"""Light from lights at points on surfaces: directly, and by way of mirrors, glossy surfaces and glass.

A cache is filled with it, and follows lights that change by sampling it anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from pathtrace.cache.lobes import irradiance_share, sampled_share, shows_lights

# Samples of lights from each point; a square, for they are stratified.
_STRATA = 2
SAMPLES = _STRATA**2
# Mirrors and glass surfaces that a ray passes at most.
_MOST_BOUNCES = 6


@dataclass(frozen=True)
class Followed:
    """What M rays found that were followed through mirrors, glossy surfaces and glass.

    Attributes:
        radiance: of the lights on the way, but for one that was hit first.
        passed: number of surfaces on the way to these lights; of several ways one by chance, more likely the
            one that brought more.
        hit: the last surface.
        side: normal of its lit side.
        valid: whether it reflects irradiance.
        shiny: whether the first surface may show lights.
        bounces: number of surfaces before the last one.
        reflectance: that of the last one times theirs; 0 where it is not valid.
    """

    radiance: Any
    passed: Any
    hit: Any
    side: Any
    valid: Any
    shiny: Any
    bounces: Any
    reflectance: Any


def surface_at(position: Any, normal: Any) -> Any:
    """Mitsuba interactions at points with unit normals of the lit side."""
    at = dr.zeros(mi.SurfaceInteraction3f, dr.width(position))
    at.p, at.n, at.t = position, mi.Normal3f(normal), mi.Float(1)
    at.sh_frame = mi.Frame3f(at.n)
    return at


def stratified(sampler: Any, lane: Any) -> Any:
    """Random points in the unit square, spread evenly over each SAMPLES lanes."""
    row, column = (lane % SAMPLES) // _STRATA, lane % _STRATA
    return mi.Point2f((column + sampler.next_1d()) / _STRATA, (row + sampler.next_1d()) / _STRATA)


def lit(scene: Any, at: Any, square: Any, other: Any, active: Any) -> tuple[Any, Any, Any]:
    """Irradiance at points from lights, by one shadow ray each and one ray that may hit a light.

    A lamp that touches a point is hardly ever sampled where it does, and then outshines all others; rays in
    any direction find it there. The two are weighed against each other (Veach and Guibas 1995).

    Args:
        scene: a Mitsuba scene.
        at: from `surface_at`.
        square: where on the lights, each light with the same chance.
        other: where the other ray's direction lies, cosine-weighted around the normal.
        active: mask of the points.

    Returns:
        The irradiance, the part of it by shadow rays, and the numbers by which kernels know their lights.
    """
    light, emitted = scene.sample_emitter_direction(at, square, True, active)
    cosine = dr.maximum(dr.dot(light.d, at.n), 0)
    share = dr.select(light.delta, 1, light.pdf / (light.pdf + cosine * dr.inv_pi))
    sampled = _finite(dr.select(active & (light.pdf > 0), emitted * cosine * share, 0))
    registered = dr.reinterpret_array(mi.UInt32, light.emitter)
    if all(mi.has_flag(one.flags(), mi.EmitterFlags.Delta) for one in scene.emitters()):
        # No ray hits such a light.
        return sampled, sampled, registered
    hit = scene.ray_intersect(_ray(at, other), active)
    emitter, found = hit.emitter(scene), mi.DirectionSample3f(scene, hit, at)
    shines = active & (emitter != None)  # noqa: E711
    pdf = dr.maximum(dr.dot(found.d, at.n), 0) * dr.inv_pi
    share = pdf / (pdf + scene.pdf_emitter_direction(at, found, shines))
    hits = _finite(dr.select(shines, dr.pi * share * emitter.eval(hit, shines), 0))
    return sampled + hits, sampled, registered


def followed(scene: Any, sampler: Any, at: Any, square: Any, active: Any) -> Followed:
    """Rays from points, in directions that a square stands for, cosine-weighted around the normal."""
    radiance, *found = _followed(scene, sampler, _ray(at, square), mi.Bool(active))
    return Followed(_finite(radiance), *found)


def _ray(at: Any, square: Any) -> Any:
    return at.spawn_ray(at.to_world(mi.warp.square_to_cosine_hemisphere(square)))


def _finite(light: Any) -> Any:
    """Light, black where it is not finite: it would spoil its cell's mean."""
    return dr.select(dr.all(dr.isfinite(light)), light, 0)


def _chosen(sampler: Any, part: Any, total: Any) -> Any:
    """Mask of the lanes in which a part of a sum is chosen in proportion to its size."""
    return sampler.next_1d() * dr.mean(total) < dr.mean(part)


@dr.syntax
def _followed(scene: Any, sampler: Any, ray: Any, active: Any) -> tuple[Any, ...]:
    """The attributes of `Followed`, in their order."""
    context, passed = mi.BSDFContext(), mi.UInt32(1)
    hit, side = dr.zeros(mi.SurfaceInteraction3f), mi.Normal3f(0)
    throughput, radiance = mi.Color3f(1), mi.Color3f(0)
    valid, shiny, bounces = mi.Bool(False), mi.Bool(False), mi.UInt32(0)
    before, pdf, specular = dr.zeros(mi.SurfaceInteraction3f), mi.Float(1), mi.Bool(True)
    while active:
        hit = scene.ray_intersect(ray, active)
        emitter = hit.emitter(scene)
        # What is seen directly was sampled as a light.
        shines = active & (bounces > 0) & (emitter != None)  # noqa: E711
        found = mi.DirectionSample3f(scene, hit, before)
        other = scene.pdf_emitter_direction(before, found, shines & ~specular)
        weight = dr.select(specular, 1, pdf / (pdf + other))
        brought = dr.select(shines, throughput * weight * emitter.eval(hit, shines), 0)
        radiance += brought
        passed = dr.select(_chosen(sampler, brought, radiance), bounces, passed)
        active &= hit.is_valid()
        bsdf = hit.bsdf()
        flags = bsdf.flags()
        shiny |= active & (bounces == 0) & shows_lights(flags)
        lobe, direction = sampler.next_1d(active), sampler.next_2d(active)
        sample, reflected = bsdf.sample(context, hit, lobe, direction, active)
        specular = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        ends = sampler.next_1d(active) < sampled_share(flags, hit.wi, sample)
        reflects = active & (dr.max(reflected) > 0)
        passes = reflects & ~ends
        valid |= reflects & ends
        side = dr.select(dr.dot(hit.n, ray.d) < 0, hit.n, -hit.n)
        # Small lights are hardly ever found in a glossy surface by chance.
        glossy = active & mi.has_flag(flags, mi.BSDFFlags.Smooth) & shows_lights(flags)
        light, emitted = scene.sample_emitter_direction(hit, sampler.next_2d(glossy), False, glossy)
        value, scatter_pdf = bsdf.eval_pdf(context, hit, hit.to_local(light.d), glossy)
        share = dr.select(light.delta, 1, light.pdf / (light.pdf + scatter_pdf))
        # What is reflected as irradiance is not seen.
        share *= 1 - irradiance_share(flags, hit.wi, hit.to_local(light.d), scatter_pdf)
        seen = glossy & (light.pdf > 0) & (share > 0)
        seen &= ~scene.ray_test(hit.spawn_ray_to(light.p), seen)
        brought = dr.select(seen, throughput * value * emitted * share, 0)
        radiance += brought
        passed = dr.select(_chosen(sampler, brought, radiance), bounces + 1, passed)
        throughput = dr.select(active, throughput * reflected, throughput)
        before, pdf = hit, sample.pdf
        active = passes & (bounces < _MOST_BOUNCES)
        ray = dr.select(active, hit.spawn_ray(hit.to_world(sample.wo)), ray)
        bounces = dr.select(active, bounces + 1, bounces)
    return radiance, passed, hit, side, valid, shiny, bounces, dr.select(valid, throughput, 0)
