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
from pathtrace.fill.direct import RAYS, followed, lit, stratified, surface_at


@dataclass(frozen=True)
class Gathered:
    """What RAYS rays from each of N points found; M = N * RAYS.

    Attributes:
        direct: (N, 3) irradiance from lights.
        reflected: (N, 3) irradiance from lights that is seen in mirrors, glossy surfaces and glass.
        lights: the samples of lights, by shadow rays.
        hits: the M points that rays hit.
        valid: (M,) whether a ray hit a surface that scatters light.
        shiny: (M,) whether the surface that it hit first may show lights.
        square: (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
        bounces: (M,) mirrors, glossy and glass surfaces on the way.
        reflectance: (M, 3) share of the irradiance of what was hit that arrives at the point.
    """

    direct: NDArray[np.float32]
    reflected: NDArray[np.float32]
    lights: LightSamples
    hits: Points
    valid: NDArray[np.bool_]
    shiny: NDArray[np.bool_]
    square: NDArray[np.float32]
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
    position, normal = mi.Point3f(points.position.T), mi.Normal3f(points.normal.T)
    at = surface_at(
        dr.gather(mi.Point3f, position, lane // RAYS), dr.gather(mi.Normal3f, normal, lane // RAYS)
    )
    square, active = stratified(sampler, lane), mi.Bool(True)
    direct, by_shadow_rays, registered = lit(scene, at, stratified(sampler, lane), square, active)
    sampled = dr.mean(by_shadow_rays)
    found = followed(scene, sampler, at, square, active)
    position, side = found.hit.p, mi.Vector3f(found.side)
    sums = [*direct, *(dr.pi * found.radiance)]
    flags = found.valid, found.shiny, found.bounces, found.reflectance
    dr.eval(sums, position, side, *flags, square, sampled, registered)
    means = np.stack([(dr.block_sum(channel, RAYS) / RAYS).numpy() for channel in sums], axis=1)
    return Gathered(
        means[:, :3],
        means[:, 3:],
        LightSamples(np.arange(lanes) // RAYS, light_numbers(scene)[registered.numpy()], sampled.numpy()),
        Points(position.numpy().T, side.numpy().T),
        found.valid.numpy(),
        found.shiny.numpy(),
        square.numpy().T,
        found.bounces.numpy().astype(np.int64),
        found.reflectance.numpy().T,
    )
