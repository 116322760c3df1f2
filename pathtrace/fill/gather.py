"""Rays from points on surfaces: the light that arrives directly, and what is seen from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cells import Points
from pathtrace.cache.lights import LightSamples, light_numbers
from pathtrace.cache.lobes import reflects_irradiance

# Rays from each point, towards lights and towards other surfaces; a square, for they are stratified.
_STRATA = 2
RAYS = _STRATA**2
# Mirrors and glass surfaces that a ray passes at most.
_MOST_BOUNCES = 6


@dataclass(frozen=True)
class Gathered:
    """What RAYS rays from each of N points found; M = N * RAYS.

    Attributes:
        direct: (N, 3) irradiance from lights, by shadow rays.
        reflected: (N, 3) irradiance from lights that is seen in mirrors, glossy surfaces and glass.
        lights: the samples of lights.
        hits: the M points that rays hit.
        valid: (M,) whether a ray hit a surface that scatters light.
        bounces: (M,) mirrors, glossy and glass surfaces on the way.
        reflectance: (M, 3) share of the irradiance of what was hit that arrives at the point.
    """

    direct: NDArray[np.float32]
    reflected: NDArray[np.float32]
    lights: LightSamples
    hits: Points
    valid: NDArray[np.bool_]
    bounces: NDArray[np.int64]
    reflectance: NDArray[np.float32]


def gather(scene: Any, points: Points, seed: int) -> Gathered:
    """Traces rays from points.

    Args:
        scene: a Mitsuba scene.
        points: where to start.
        seed: same seed, same rays.
    """
    lanes = len(points) * RAYS
    lane = dr.arange(mi.UInt32, lanes)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), lanes)
    at = dr.zeros(mi.SurfaceInteraction3f, lanes)
    at.p = dr.gather(mi.Point3f, mi.Point3f(points.position.T), lane // RAYS)
    at.n = dr.gather(mi.Normal3f, mi.Normal3f(points.normal.T), lane // RAYS)
    at.sh_frame, at.t = mi.Frame3f(at.n), mi.Float(1)
    row, column = (lane % RAYS) // _STRATA, lane % _STRATA
    even = lambda: mi.Point2f(  # noqa: E731
        (column + sampler.next_1d()) / _STRATA, (row + sampler.next_1d()) / _STRATA
    )
    light, emitted = scene.sample_emitter_direction(at, even(), True)
    direct = dr.select(light.pdf > 0, emitted * dr.maximum(dr.dot(light.d, at.n), 0), 0)
    sampled = dr.mean(direct)
    registered = dr.reinterpret_array(mi.UInt32, light.emitter)
    ray = at.spawn_ray(at.to_world(mi.warp.square_to_cosine_hemisphere(even())))
    found, hit, side, valid, bounces, reflectance = _followed(scene, sampler, ray)
    position, side = hit.p, mi.Vector3f(side)
    sums = [*direct, *(dr.pi * found)]
    dr.eval(sums, position, side, valid, bounces, reflectance, sampled, registered)
    means = np.stack([(dr.block_sum(channel, RAYS) / RAYS).numpy() for channel in sums], axis=1)
    means[~np.isfinite(means)] = 0
    return Gathered(
        means[:, :3],
        means[:, 3:],
        LightSamples(np.arange(lanes) // RAYS, light_numbers(scene)[registered.numpy()], sampled.numpy()),
        Points(position.numpy().T, side.numpy().T),
        valid.numpy(),
        bounces.numpy().astype(np.int64),
        reflectance.numpy().T,
    )


@dr.syntax
def _followed(scene: Any, sampler: Any, ray: Any) -> tuple[Any, ...]:
    """Follows rays through mirrors, glossy surfaces and glass.

    Returns:
        Radiance of lights found there; the last hit, its lit side, whether it reflects irradiance, the number
        of surfaces before it, and its reflectance times theirs.
    """
    context = mi.BSDFContext()
    hit, side = dr.zeros(mi.SurfaceInteraction3f), mi.Normal3f(0)
    throughput, radiance = mi.Color3f(1), mi.Color3f(0)
    active, valid, bounces = mi.Bool(True), mi.Bool(False), mi.UInt32(0)
    before, pdf, specular = dr.zeros(mi.SurfaceInteraction3f), mi.Float(1), mi.Bool(True)
    while active:
        hit = scene.ray_intersect(ray, active)
        emitter = hit.emitter(scene)
        # What is seen directly was sampled as a light.
        shines = active & (bounces > 0) & (emitter != None)  # noqa: E711
        found = mi.DirectionSample3f(scene, hit, before)
        other = scene.pdf_emitter_direction(before, found, shines & ~specular)
        weight = dr.select(specular, 1, pdf / (pdf + other))
        radiance += dr.select(shines, throughput * weight * emitter.eval(hit, shines), 0)
        active &= hit.is_valid()
        bsdf = hit.bsdf()
        lobe, direction = sampler.next_1d(active), sampler.next_2d(active)
        sample, reflected = bsdf.sample(context, hit, lobe, direction, active)
        passes = active & ~reflects_irradiance(sample) & (dr.max(reflected) > 0)
        valid |= active & ~passes
        side = dr.select(dr.dot(hit.n, ray.d) < 0, hit.n, -hit.n)
        specular = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        # Small lights are hardly ever found in a glossy surface by chance.
        glossy = passes & ~specular
        light, emitted = scene.sample_emitter_direction(hit, sampler.next_2d(glossy), True, glossy)
        value, scatter_pdf = bsdf.eval_pdf(context, hit, hit.to_local(light.d), glossy)
        share = dr.select(light.delta, 1, light.pdf / (light.pdf + scatter_pdf))
        radiance += dr.select(glossy & (light.pdf > 0), throughput * value * emitted * share, 0)
        throughput = dr.select(active, throughput * reflected, throughput)
        before, pdf = hit, sample.pdf
        active = passes & (bounces < _MOST_BOUNCES)
        ray = dr.select(active, hit.spawn_ray(hit.to_world(sample.wo)), ray)
        bounces = dr.select(active, bounces + 1, bounces)
    return radiance, hit, side, valid, bounces, dr.select(valid, throughput, 0)
