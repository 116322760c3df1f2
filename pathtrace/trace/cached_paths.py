"""Paths that trace what the viewer sees, and end in a cache of irradiance soon after that.

The first surface that is not a mirror or clear glass gets several shadow rays, for most of the noise is that
of its direct light, and one scattered ray. The surface which that one hits reflects light that is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from pathtrace.cache.cache import CacheArrays, look_up
from pathtrace.cache.lights import Lights
from pathtrace.cache.lobes import reflects_irradiance
from pathtrace.trace.sequences import LIGHT, SCATTERING, Sequences

_UNBOUNDED = 1 << 30
# Share of paths that survive roulette at most.
_SURVIVAL = 0.95


@dataclass(frozen=True)
class PathSettings:
    """How paths are traced; part of the kernel.

    Attributes:
        max_depth: number of path segments at most; below 0 for no bound.
        roulette_depth: depth from which Russian roulette may end paths.
        shadow_rays: at the first surface that scatters light; 1 at all others.
    """

    max_depth: int
    roulette_depth: int
    shadow_rays: int


@dr.syntax
def path_radiance(
    scene: Any,
    sampler: Any,
    ray: Any,
    active: Any,
    settings: PathSettings,
    sequences: Sequences,
    cache: CacheArrays,
) -> Any:
    """Radiance along rays, as a path tracer with multiple importance sampling estimates it.

    Args:
        scene: a Mitsuba scene.
        sampler: random numbers.
        ray: N Mitsuba rays.
        active: (N,) mask.
        settings: how paths are traced.
        sequences: where the first surface's samples of lights and directions come from.
        cache: in which paths end; with one that knows no cell, the result is unbiased.

    Returns:
        N linear colours.
    """
    context, depths = mi.BSDFContext(), settings.max_depth if settings.max_depth >= 0 else _UNBOUNDED
    radiance, throughput = mi.Color3f(0), mi.Color3f(1)
    ray, active = mi.Ray3f(ray), mi.Bool(active)
    # Of the vertex before: where it is, how its direction was sampled, and how many samples its light had.
    before, pdf = dr.zeros(mi.SurfaceInteraction3f), mi.Float(1)
    specular, light_samples = mi.Bool(True), mi.Float(1)
    lights, row = Lights(scene, cache.lights), mi.UInt32(0)
    depth, scattered, spread = mi.UInt32(0), mi.Bool(False), mi.Float(0)
    while dr.hint(active, exclude=[settings, sequences, cache, lights]):
        hit = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
        # Light that the surface emits; sampling lights would have found it, too.
        emitter = hit.emitter(scene)
        found = mi.DirectionSample3f(scene, hit, before)
        shines = active & (emitter != None)  # noqa: E711
        other_pdf = light_samples * lights.pdf(before, row, found, shines & ~specular)
        weight = dr.select(specular, 1, pdf / (pdf + other_pdf))
        radiance += dr.select(shines, throughput * weight * emitter.eval(hit, shines), 0)
        active &= hit.is_valid() & (depth + 1 < depths)
        # Spread of the path (Bekaert et al. 2003): what lies within it may be replaced by its mean.
        facing = dr.dot(hit.n, ray.d)
        step = dr.sqrt(dr.square(hit.t) / dr.maximum(pdf * dr.abs(facing), 1e-6))
        spread += dr.select(specular, 0, step)
        bsdf = hit.bsdf()
        rough = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        first = rough & ~scattered
        # Scattering is sampled before direct light, since its weight is what a cached surface reflects.
        lobe, direction = sampler.next_1d(active), sampler.next_2d(active)
        even = mi.Point2f(*sequences.point(SCATTERING, sequences.number))
        direction = dr.select(first, even, direction)
        sample, reflected = bsdf.sample(context, hit, lobe, direction, active)
        sampled_specular = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        lit = rough
        side = dr.select(facing < 0, hit.n, -hit.n)
        asks = rough & scattered & reflects_irradiance(sample)
        left, jitter = depths - depth - 1, sampler.next_2d(active)
        known, irradiance = look_up(cache.irradiance, hit.p, side, dr.square(spread), left, jitter, asks)
        radiance += dr.select(known, throughput * reflected * irradiance * dr.inv_pi, 0)
        active &= ~known
        lit &= ~known
        row = lights.row(hit.p, side, lit)
        count = dr.select(first, mi.UInt32(settings.shadow_rays), 1)
        direct, number = mi.Color3f(0), mi.UInt32(0)
        while dr.hint(lit & (number < count), exclude=[settings, sequences, lights]):
            point = sampler.next_2d(lit)
            index = sequences.number * settings.shadow_rays + number
            point = dr.select(first, mi.Point2f(*sequences.point(LIGHT, index)), point)
            light, emitted = lights.sample(hit, row, point, lit)
            seen = lit & (light.pdf > 0)
            reflectance, scatter_pdf = bsdf.eval_pdf(context, hit, hit.to_local(light.d), seen)
            share = mi.Float(count) * light.pdf
            share = dr.select(light.delta, 1, share / (share + scatter_pdf))
            direct += dr.select(seen, reflectance * emitted * share, 0)
            number += 1
        radiance += dr.select(lit, throughput * direct / mi.Float(count), 0)
        throughput = dr.select(active, throughput * reflected, throughput)
        before, pdf, specular = hit, sample.pdf, sampled_specular
        light_samples = mi.Float(count)
        ray = hit.spawn_ray(hit.to_world(sample.wo))
        scattered |= active & ~specular
        depth += 1
        survival = dr.minimum(dr.max(throughput), _SURVIVAL)
        plays = depth >= settings.roulette_depth
        active &= (survival > 0) & (~plays | (sampler.next_1d(active) < survival))
        throughput = dr.select(plays, throughput / survival, throughput)
    return radiance
