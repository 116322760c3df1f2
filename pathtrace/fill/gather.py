"""What is gathered at points on surfaces: the light of lights, what rays see from there, and both over time.

Light of lights comes directly, and by way of mirrors, glossy surfaces and glass. A cache is filled with it,
and follows lights that change by sampling it anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.interpolate import interp1d

from pathtrace.cache.cells import Floats, Indices, Mask, Points, joined_points
from pathtrace.cache.irradiance_cache import (
    IrradianceCache,
    irradiance_share,
    look_up,
    sampled_share,
    shows_lights,
)
from pathtrace.cache.light_selection import LightSamples, light_numbers
from pathtrace.scene.instances import AnyScene, of_mitsuba
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import random_numbers

# Samples of lights from each point; a square, for they are stratified.
_STRATA = 2
SAMPLES = _STRATA**2
# Mirrors and glass surfaces that a ray passes at most.
_MOST_BOUNCES = 6
# Over time: how often the lights are sampled at each point and time, a few samples each; rays from each point
# for the light that comes over other surfaces; and times at which these are followed from what moves: light
# from all sides changes slowly.
_ROUNDS, _RAYS, _INDIRECT = 4, 16, 17
# Any cell will do for these rays.
_ANY_AREA = 1e9


@dataclass(frozen=True)
class Followed:
    """What M rays found, as in `Seen`, but for the last surface, and the normal of its lit side."""

    radiance: mi.Color3f
    passed: mi.UInt32
    hit: mi.SurfaceInteraction3f
    side: mi.Normal3f
    valid: mi.Bool
    shiny: mi.Bool
    bounces: mi.UInt32
    reflectance: mi.Color3f


def surfaces_at(places: tuple[Any, Any], index: mi.UInt32, active: mi.Bool = True) -> mi.SurfaceInteraction3f:
    """Mitsuba interactions at some places, given all positions and unit normals of the lit side."""
    position = dr.gather(mi.Point3f, places[0], index, active)
    normal = dr.gather(mi.Normal3f, places[1], index, active)
    at = dr.zeros(mi.SurfaceInteraction3f, dr.width(position))
    at.p, at.n, at.t = position, normal, mi.Float(1)
    at.sh_frame = mi.Frame3f(at.n)
    return at


def stratified(sampler: mi.Sampler, lane: mi.UInt32) -> mi.Point2f:
    """Random points in the unit square, spread evenly over each SAMPLES lanes."""
    row, column = (lane % SAMPLES) // _STRATA, lane % _STRATA
    return mi.Point2f((column + sampler.next_1d()) / _STRATA, (row + sampler.next_1d()) / _STRATA)


def lit(
    scene: AnyScene, at: mi.SurfaceInteraction3f, square: mi.Point2f, other: mi.Point2f, active: mi.Bool
) -> tuple[Any, Any, Any]:
    """Irradiance at points from lights, by one shadow ray each and one ray that may hit a light.

    A lamp that touches a point is hardly ever sampled where it does; rays in any direction find it there. The
    two are weighed against each other (Veach and Guibas 1995).

    Args:
        scene, at: a scene, and `surfaces_at` it; only those that are active count.
        square: where on the lights, each light with the same chance.
        other: where the other ray's direction lies, cosine-weighted around the normal.

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
    hit = scene.ray_intersect(_ray(at, other), active=active)
    whole = of_mitsuba(scene)
    emitter, found = hit.emitter(whole), mi.DirectionSample3f(whole, hit, at)
    shines = active & (emitter != None)  # noqa: E711
    pdf = dr.maximum(dr.dot(found.d, at.n), 0) * dr.inv_pi
    share = pdf / (pdf + scene.pdf_emitter_direction(at, found, shines))
    hits = _finite(dr.select(shines, dr.pi * share * emitter.eval(hit, shines), 0))
    return sampled + hits, sampled, registered


def _ray(at: mi.SurfaceInteraction3f, square: mi.Point2f) -> mi.Ray3f:
    return at.spawn_ray(at.to_world(mi.warp.square_to_cosine_hemisphere(square)))


def _finite(light: mi.Color3f) -> mi.Color3f:
    """Light, black where it is not finite: it would spoil its cell's mean."""
    return dr.select(dr.all(dr.isfinite(light)), light, 0)


def _chosen(sampler: mi.Sampler, part: mi.Color3f, total: mi.Color3f) -> mi.Bool:
    """Mask of the lanes in which a part of a sum is chosen in proportion to its size."""
    return sampler.next_1d() * dr.mean(total) < dr.mean(part)


@dr.syntax
def followed(
    scene: AnyScene, sampler: mi.Sampler, at: mi.SurfaceInteraction3f, square: mi.Point2f, active: mi.Bool
) -> Followed:
    """Rays from points, in directions that a square stands for, cosine-weighted around the normal."""
    ray, active = _ray(at, square), mi.Bool(active)
    context, passed = mi.BSDFContext(), mi.UInt32(1)
    hit, side = dr.zeros(mi.SurfaceInteraction3f), mi.Normal3f(0)
    throughput, radiance = mi.Color3f(1), mi.Color3f(0)
    valid, shiny, bounces = mi.Bool(False), mi.Bool(False), mi.UInt32(0)
    before, pdf, specular = dr.zeros(mi.SurfaceInteraction3f), mi.Float(1), mi.Bool(True)
    while active:
        hit = scene.ray_intersect(ray, active=active)
        emitter = hit.emitter(of_mitsuba(scene))
        # What is seen directly was sampled as a light.
        shines = active & (bounces > 0) & (emitter != None)  # noqa: E711
        found = mi.DirectionSample3f(of_mitsuba(scene), hit, before)
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
    reflectance = dr.select(valid, throughput, 0)
    return Followed(_finite(radiance), passed, hit, side, valid, shiny, bounces, reflectance)


@dataclass(frozen=True)
class Seen:
    """What M rays from points found."""

    point: Indices  # (M,) index of the point that each started at
    # (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
    square: Floats
    # (M, 3) of lights in mirrors, glossy surfaces and glass, but for one hit first.
    radiance: Floats
    # (M,) number of such surfaces on the way to them, at least 1; of several ways one by chance.
    passed: Indices
    hits: Points  # the M points that they hit last
    valid: Mask  # (M,) whether a ray hit a surface that reflects irradiance
    shiny: Mask  # (M,) whether the surface that it hit first may show lights
    bounces: Indices  # (M,) mirrors, glossy and glass surfaces on the way
    # (M, 3) share of the irradiance of what was hit that arrives at the point; 0 if not valid.
    reflectance: Floats

    @staticmethod
    def joined(parts: Sequence[Seen]) -> Seen:
        """What the rays of all parts found, one part after the other; the points are counted as one list."""
        values = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Seen)
            if field.name != "hits"
        }
        return Seen(**values, hits=joined_points([part.hits for part in parts]))


def gather_direct(scene: AnyScene, points: Points, seed: int) -> tuple[Floats, LightSamples]:
    """Irradiance (N, 3) at points from lights, and SAMPLES samples of these at each; same seed, same ones."""
    state = dr.opaque(mi.UInt32, seed)
    *means, sampled, registered = sampled_lights(scene, state, points.arrays, len(points))
    light = light_numbers(scene)[registered.numpy()]
    samples = LightSamples(np.arange(len(light)) // SAMPLES, light, sampled.numpy())
    return np.stack([channel.numpy() for channel in means], axis=1), samples


def sampled_lights(
    scene: AnyScene,
    state: mi.UInt32,
    places: tuple[Any, Any],
    count: int,
    first: mi.UInt32 | int = 0,
    total: int | None = None,
) -> tuple[Any, ...]:
    """Three channels of irradiance at `count` of `total` places, that of each sample, and light numbers."""
    lane = dr.arange(mi.UInt32, count * SAMPLES)
    sampler = random_numbers(state, count * SAMPLES)
    point = first + lane // SAMPLES
    active = mi.Bool(True) if total is None else point < total
    squares = stratified(sampler, lane), stratified(sampler, lane)
    at = surfaces_at(places, point, active)
    irradiance, by_shadow_rays, registered = lit(scene, at, *squares, active)
    samples = [*irradiance, dr.mean(by_shadow_rays), registered]
    dr.eval(samples)
    means = [dr.block_sum(channel, SAMPLES) / SAMPLES for channel in samples[:3]]
    dr.eval(means)
    return *means, *samples[3:]


def gather_seen(scene: AnyScene, points: Points, point: Indices, square: Floats, seed: int) -> Seen:
    """Follows M rays from points; `point` and `square` are those of `Seen`. Same seed, same ways."""
    sampler = random_numbers(dr.opaque(mi.UInt32, seed), len(point))
    at = surfaces_at(points.arrays, mi.UInt32(point.astype(np.uint32)))
    found = followed(scene, sampler, at, mi.Point2f(square.T), mi.Bool(True))
    position, side = found.hit.p, mi.Vector3f(found.side)
    flags = found.passed, found.valid, found.shiny, found.bounces
    dr.eval(found.radiance, position, side, flags, found.reflectance)
    return Seen(
        point,
        square,
        radiance=found.radiance.numpy().T,
        passed=found.passed.numpy().astype(np.int64),
        hits=Points(position.numpy().T, side.numpy().T),
        valid=found.valid.numpy(),
        shiny=found.shiny.numpy(),
        bounces=found.bounces.numpy().astype(np.int64),
        reflectance=found.reflectance.numpy().T,
    )


def irradiance_over_time(
    scene: Scene,
    cache: IrradianceCache,
    points: Callable[[float], Points],
    moving: Indices,
    times: Sequence[float],
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Floats:
    """(T, 3, N) irradiance of N points, of which (M,) move, at T times from 0 to 1, ascending.

    Light that comes over other surfaces has the cache's irradiance, of time 0, there; on what stands still,
    it is as at time 0. All times have the same random numbers, so that their ratios have little noise.

    `points` says where the N points are at a time; progress is told the times done and their number.
    Afterwards the scene shows the last time.
    """
    scene.set_time(0.0)
    indirect = _indirect(scene, cache, points(0.0), seed)
    found = np.empty((len(times), *indirect.shape), dtype=np.float32)
    some = np.unique(np.linspace(0, len(times) - 1, _INDIRECT).round().astype(int))
    arriving = []
    for number, time in enumerate(times):
        scene.set_time(time)
        now = points(time)
        rounds = [gather_direct(scene.traced, now, seed + n)[0] for n in range(_ROUNDS)]
        found[number] = indirect + np.mean(rounds, axis=0).T
        if len(moving) and number in some:
            arriving.append(_indirect(scene, cache, now.take(moving), seed))
        progress(number + 1, len(times))
    if len(moving):
        found[..., moving] += interp1d(some, arriving, axis=0)(np.arange(len(times))) - indirect[:, moving]
    # Rounding may leave a little less than nothing.
    return np.maximum(found, 0, out=found)


def _indirect(scene: Scene, cache: IrradianceCache, points: Points, seed: int) -> Floats:
    """(3, N) irradiance that arrives over other surfaces, whose own irradiance is that of the cache."""
    rng = np.random.default_rng(seed)
    start = np.repeat(np.arange(len(points)), _RAYS)
    seen = gather_seen(scene.traced, points, start, rng.random((len(start), 2), dtype=np.float32), seed)
    position, normal = mi.Point3f(seen.hits.position.T), mi.Vector3f(seen.hits.normal.T)
    how = mi.Float(_ANY_AREA), mi.UInt32(len(cache.irradiance)), mi.Point2f(0.5), mi.Bool(seen.valid)
    _, irradiance = look_up(cache.arrays(scene.mitsuba).irradiance, position, normal, *how)
    dr.eval(irradiance)
    # Of the radiance that arrives, irradiance is pi times the mean over cosine-weighted directions.
    arriving = seen.reflectance * irradiance.numpy().T * seen.valid[:, None] + np.pi * seen.radiance
    return arriving.reshape(-1, _RAYS, 3).mean(axis=1).T.astype(np.float32)
