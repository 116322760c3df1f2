"""Paths that trace what the viewer sees, and end in a cache of irradiance soon after that.

The first surface that is not a mirror or clear glass gets several shadow rays, for most of the noise is that
of its direct light, and one scattered ray. The surface which that one hits reflects light that is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from pathtrace.cache.irradiance_cache import (
    CacheArrays,
    irradiance_share,
    look_up,
    sampled_share,
    shows_lights,
)
from pathtrace.cache.light_selection import Lights
from pathtrace.scene.instances import AnyScene, of_mitsuba
from pathtrace.trace.film import LIGHT, SCATTERING, Sequences

# The bound on the segments of paths that have none.
LONGEST = 1 << 30
# Share of paths that survive roulette at most.
_SURVIVAL = 0.95


@dataclass(frozen=True)
class PathSettings:
    """How paths are traced; part of the kernel, except for depths that are opaque (mi.UInt32)."""

    max_depth: int | mi.UInt32  # number of path segments at most; below 0 for no bound
    roulette_depth: int | mi.UInt32  # depth from which Russian roulette may end paths
    shadow_rays: int  # at the first surface that scatters light; 1 at all others
    # Whether thin glass lets shadow rays pass. Paths pass it as if it were not there: it is no path
    # segment, and what lies behind it is sampled as a light and as a direction.
    thin_glass: bool = False
    # What indirect light of the first surface that scatters may add to a path at once, in its largest
    # channel; None for no bound, without which the result is unbiased.
    most_indirect: float | None = None


class DepthBins:
    """Adds up luminance by the number of segments of paths, and counts segments, for groups of paths apart.

    There are G groups; `group` (N,) is that of each path, and paths of more than `most` segments count as of
    so many. Sums (G * most,) are luminance; segments (G,) are counted.
    """

    def __init__(self, most: int, groups: int, group: mi.UInt32) -> None:
        self.sums = dr.zeros(mi.Float, groups * most)
        self.segments = dr.zeros(mi.UInt32, groups)
        self._most, self._group = most, group

    def add(self, active: mi.Bool, *added: tuple[Any, Any]) -> None:
        """Takes which of N paths have another segment, and colours with their paths' number of segments."""
        dr.scatter_add(self.segments, mi.UInt32(1), self._group, active)
        for radiance, segments in added:
            luminance = mi.luminance(radiance)
            index = self._group * self._most + dr.minimum(segments, self._most) - 1
            dr.scatter_add(self.sums, luminance, index, dr.isfinite(luminance) & (luminance > 0))


@dr.syntax
def path_radiance(  # noqa: PLR0913 (the state of a symbolic loop)
    scene: AnyScene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    surface: mi.SurfaceInteraction3f,
    active: mi.Bool,
    settings: PathSettings,
    sequences: Sequences,
    cache: CacheArrays,
    bins: DepthBins | None = None,
) -> mi.Color3f:
    """N linear colours: radiance along rays, as multiple importance sampling estimates it.

    Args:
        scene, sampler, settings: of Mitsuba, and how paths are traced.
        ray, surface: N Mitsuba rays, and interactions with what they hit first, of which some are active.
        sequences: where the first surface's samples of lights and directions come from.
        cache: in which paths end; with one that knows no cell, the result is unbiased.
        bins: adds up what paths of each number of segments bring.
    """
    bounded = not isinstance(settings.max_depth, int) or settings.max_depth >= 0
    depths = settings.max_depth if bounded else LONGEST
    radiance, throughput, ray, active = mi.Color3f(0), mi.Color3f(1), mi.Ray3f(ray), mi.Bool(active)
    hit = mi.SurfaceInteraction3f(surface)
    # Of the vertex before: where it is, how its direction was sampled, and how many samples its light had.
    before, pdf = dr.zeros(mi.SurfaceInteraction3f), mi.Float(1)
    specular, light_samples = mi.Bool(True), mi.Float(1)
    lights, row = Lights(scene, cache.lights, settings.thin_glass), mi.UInt32(0)
    depth, scattered, spread = mi.UInt32(0), mi.Bool(False), mi.Float(0)
    # Whether what is hit sheds indirect light on the first surface that scatters.
    indirect = mi.Bool(False)
    while dr.hint(active, exclude=[settings, sequences, cache, lights, bins]):
        emitted = _emitted(scene, lights, hit, before, row, pdf / light_samples, specular, active)
        shone = _bounded(settings, throughput * emitted, indirect)
        radiance += shone
        active &= hit.is_valid() & (depth + 1 < depths)
        spread += dr.select(specular, 0, _step(hit, ray, pdf))
        side = dr.select(dr.dot(hit.n, ray.d) < 0, hit.n, -hit.n)
        flags = hit.bsdf().flags()
        rough = active & mi.has_flag(flags, mi.BSDFFlags.Smooth)
        first = rough & ~scattered
        # Scattering is sampled before direct light, since its weight is what a cached surface reflects.
        lobe, even = sampler.next_1d(active), mi.Point2f(*sequences.point(SCATTERING, sequences.number))
        direction = dr.select(first, even, sampler.next_2d(active))
        sample, reflected = hit.bsdf().sample(mi.BSDFContext(), hit, lobe, direction, active)
        asks = rough & scattered & mi.has_flag(flags, mi.BSDFFlags.Diffuse)
        left, jitter = depths - depth - 1, sampler.next_2d(active)
        known, irradiance = look_up(cache.irradiance, hit.p, side, dr.square(spread), left, jitter, asks)
        share = dr.select(known, sampled_share(flags, hit.wi, sample), 0)
        stored = dr.select(share > 0, throughput * reflected * share * irradiance * dr.inv_pi, 0)
        radiance += _bounded(settings, stored, scattered)
        # What the cache does not stand for goes on, or is found by shadow rays.
        lit = rough & (~known | shows_lights(flags))
        here = lights.row(hit.p, side, lit)
        count = dr.select(first, mi.UInt32(settings.shadow_rays), 1)
        direct = _direct(lights, sampler, sequences, hit, here, first, count, known, lit)
        found = _bounded(settings, throughput * direct, scattered)
        radiance += found
        _tell(bins, active, (shone, depth + 1), (found, depth + 2))
        active &= sampler.next_1d(active) >= share
        throughput = dr.select(active, throughput * reflected, throughput)
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        passes = _passes(settings, sample)
        # What passes thin glass still comes from the vertex before it.
        before, row = dr.select(passes, before, hit), dr.select(passes, row, here)
        pdf = dr.select(passes, pdf, sample.pdf)
        light_samples = dr.select(passes, light_samples, mi.Float(count))
        specular = dr.select(passes, specular, delta)
        ray = hit.spawn_ray(hit.to_world(sample.wo))
        indirect |= scattered & ~passes
        scattered |= active & ~delta
        depth += dr.select(passes, mi.UInt32(0), mi.UInt32(1))
        throughput, active = _roulette(sampler, throughput, depth >= settings.roulette_depth, active)
        hit = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
    return radiance


def _tell(bins: DepthBins | None, active: mi.Bool, *added: tuple[Any, Any]) -> None:
    if bins is not None:
        bins.add(active, *added)


def _bounded(settings: PathSettings, added: mi.Color3f, indirect: mi.Bool) -> mi.Color3f:
    """N colours that are added to paths, made darker where they are indirect light beyond the bound."""
    if settings.most_indirect is None:
        return added
    scale = settings.most_indirect * dr.rcp(dr.maximum(dr.max(added), settings.most_indirect))
    return dr.select(indirect, added * scale, added)


def _passes(settings: PathSettings, sample: mi.BSDFSample3f) -> mi.Bool:
    if settings.thin_glass:
        return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
    return mi.Bool(False)


def _emitted(
    scene: AnyScene,
    lights: Lights,
    hit: mi.SurfaceInteraction3f,
    before: mi.SurfaceInteraction3f,
    row: mi.UInt32,
    pdf: mi.Float,
    specular: mi.Bool,
    active: mi.Bool,
) -> mi.Color3f:
    """Light that a surface or the sky emits, weighed against that which shadow rays found.

    `before` and `row` are the vertex before and its row of the choice of lights, `pdf` the density with which
    scattering chose the direction, over the number of shadow rays. No shadow ray could have found the light
    of paths that are `specular`.
    """
    emitter = hit.emitter(of_mitsuba(scene))
    found = mi.DirectionSample3f(of_mitsuba(scene), hit, before)
    shines = active & (emitter != None)  # noqa: E711
    weight = pdf / (pdf + lights.pdf(before, row, found, shines & ~specular))
    return dr.select(shines, dr.select(specular, 1, weight) * emitter.eval(hit, shines), 0)


def _step(hit: mi.SurfaceInteraction3f, ray: mi.Ray3f, pdf: mi.Float) -> mi.Float:
    """By how much the spread of paths grows that were scattered with a density and hit a surface.

    What lies within the square of the spread may be replaced by its mean (Bekaert et al. 2003).
    """
    return dr.sqrt(dr.square(hit.t) / dr.maximum(pdf * dr.abs(dr.dot(hit.n, ray.d)), 1e-6))


def _roulette(
    sampler: mi.Sampler, throughput: mi.Color3f, plays: mi.Bool, active: mi.Bool
) -> tuple[Any, Any]:
    """Throughput and mask of the paths that survive Russian roulette; only some of them play it."""
    survival = dr.minimum(dr.max(throughput), _SURVIVAL)
    survives = ~plays | (sampler.next_1d(active) < survival)
    return dr.select(plays, throughput / survival, throughput), active & (survival > 0) & survives


@dr.syntax
def _direct(  # noqa: PLR0913 (the state of a symbolic loop)
    lights: Lights,
    sampler: mi.Sampler,
    sequences: Sequences,
    hit: mi.SurfaceInteraction3f,
    row: mi.UInt32,
    first: mi.Bool,
    count: mi.UInt32,
    known: mi.Bool,
    active: mi.Bool,
) -> mi.Color3f:
    """Light that arrives from lights directly and is reflected, by `count` (N,) shadow rays each.

    Where the surface is the `first` one that scatters light, the sequences say where these rays go. Where
    its irradiance is `known`, what that stands for is left out.
    """
    context, bsdf = mi.BSDFContext(), hit.bsdf()
    flags = bsdf.flags()
    direct, number = mi.Color3f(0), mi.UInt32(0)
    while dr.hint(active & (number < count), exclude=[sequences, lights]):
        point = sampler.next_2d(active)
        index = sequences.number * count + number
        point = dr.select(first, mi.Point2f(*sequences.point(LIGHT, index)), point)
        light, emitted = lights.sample(hit, row, point, active)
        seen = active & (light.pdf > 0)
        reflectance, scatter_pdf = bsdf.eval_pdf(context, hit, hit.to_local(light.d), seen)
        share = mi.Float(count) * light.pdf
        share = dr.select(light.delta, 1, share / (share + scatter_pdf))
        cached = irradiance_share(flags, hit.wi, hit.to_local(light.d), scatter_pdf)
        # Seen from the sphere that it is, a lamp has neither density nor direction.
        share = dr.select(seen, share * dr.select(known, 1 - cached, 1), 0)
        direct += reflectance * share * lights.arriving(hit, light, emitted, share > 0)
        number += 1
    return direct / mi.Float(count)
