"""What is gathered at points on surfaces: the light of lights, and what rays see from there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cells import Points, joined_points
from pathtrace.cache.lights import LightSamples, light_numbers
from pathtrace.fill.direct import SAMPLES, followed, lit, stratified, surface_at


@dataclass(frozen=True)
class Direct:
    """Light that lights send to N points, by SAMPLES samples at each.

    Attributes:
        irradiance: (N, 3) from lights.
        samples: of the lights, by shadow rays.
    """

    irradiance: NDArray[np.float32]
    samples: LightSamples


@dataclass(frozen=True)
class Seen:
    """What M rays from points found.

    Attributes:
        point: (M,) index of the point that each started at.
        square: (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
        radiance: (M, 3) of the lights that it met in mirrors, glossy surfaces and glass.
        passed: (M,) number of such surfaces on the way to the lights, at least 1.
        hits: the M points that they hit.
        valid: (M,) whether a ray hit a surface that scatters light.
        shiny: (M,) whether the surface that it hit first may show lights.
        bounces: (M,) mirrors, glossy and glass surfaces on the way.
        reflectance: (M, 3) share of the irradiance of what was hit that arrives at the point.
    """

    point: NDArray[np.int64]
    square: NDArray[np.float32]
    radiance: NDArray[np.float32]
    passed: NDArray[np.int64]
    hits: Points
    valid: NDArray[np.bool_]
    shiny: NDArray[np.bool_]
    bounces: NDArray[np.int64]
    reflectance: NDArray[np.float32]

    @staticmethod
    def joined(parts: Sequence[Seen]) -> Seen:
        """What the rays of all parts found, one part after the other; the points are counted as one list."""
        values = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(Seen)
            if field.name != "hits"
        }
        return Seen(**values, hits=joined_points([part.hits for part in parts]))


def gather_direct(scene: Any, points: Points, seed: int) -> Direct:
    """Samples the lights from points.

    Args:
        scene: a Mitsuba scene.
        points: where light arrives.
        seed: same seed, same samples.
    """
    lanes = len(points) * SAMPLES
    lane = dr.arange(mi.UInt32, lanes)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), lanes)
    at = _surfaces(points, lane // SAMPLES)
    squares = stratified(sampler, lane), stratified(sampler, lane)
    irradiance, by_shadow_rays, registered = lit(scene, at, *squares, mi.Bool(True))
    sampled = dr.mean(by_shadow_rays)
    dr.eval(irradiance, sampled, registered)
    means = np.stack([(dr.block_sum(channel, SAMPLES) / SAMPLES).numpy() for channel in irradiance], axis=1)
    light = light_numbers(scene)[registered.numpy()]
    return Direct(means, LightSamples(np.arange(lanes) // SAMPLES, light, sampled.numpy()))


def gather_seen(
    scene: Any, points: Points, point: NDArray[np.int64], square: NDArray[np.float32], seed: int
) -> Seen:
    """Follows rays from points.

    Args:
        scene: a Mitsuba scene.
        points: where they start.
        point: (M,) index of the point that each starts at.
        square: (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
        seed: same seed, same ways through mirrors and glass.
    """
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), len(point))
    at = _surfaces(points, mi.UInt32(point.astype(np.uint32)))
    found = followed(scene, sampler, at, mi.Point2f(square.T), mi.Bool(True))
    position, side = found.hit.p, mi.Vector3f(found.side)
    flags = found.passed, found.valid, found.shiny, found.bounces
    dr.eval(found.radiance, position, side, *flags, found.reflectance)
    return Seen(
        point,
        square,
        found.radiance.numpy().T,
        found.passed.numpy().astype(np.int64),
        Points(position.numpy().T, side.numpy().T),
        found.valid.numpy(),
        found.shiny.numpy(),
        found.bounces.numpy().astype(np.int64),
        found.reflectance.numpy().T,
    )


def _surfaces(points: Points, index: Any) -> Any:
    """Mitsuba interactions at points, chosen by their indices."""
    position, normal = mi.Point3f(points.position.T), mi.Normal3f(points.normal.T)
    return surface_at(dr.gather(mi.Point3f, position, index), dr.gather(mi.Normal3f, normal, index))
