"""Radiance and geometry at any list of film positions, be they a disc, a frame or a warped grid.

Everything that changes from frame to frame (camera, positions, seed) enters the traced functions as an
evaluated array, so that a moving gaze or camera neither traces Python again nor compiles anything.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.frozen import interrupted_by_ctrl_c
from compose.camera.camera import Camera
from pathtrace.cache.irradiance_cache import CacheArrays, IrradianceCache
from pathtrace.scene.backend import require_backend
from pathtrace.scene.instances import AnyScene, FrozenWithScenes, registered
from pathtrace.scene.scene import Scene
from pathtrace.trace.cached_paths import PathSettings, path_radiance
from pathtrace.trace.film import (
    Batch,
    FilmPositions,
    Offset,
    SampleCounts,
    Sequences,
    clipped,
    joined_channels,
    mixed_seeds,
    opaque_camera,
    random_numbers,
    ray_through,
)
from pathtrace.trace.first_hit import (
    AuxiliaryFeatures,
    FirstHits,
    Unseen,
    auxiliary_features,
    auxiliary_hits,
    first_hits,
    has_clear_surfaces,
    veil,
)

# Lanes traced at once: bounds the memory that many samples of a large frame take. Samples of a position are
# traced in several passes, and positions in several parts where they alone are more than that.
_MAX_LANES = 1 << 22
# How much farther than a flat mirror what it shows is, at least.
_BEYOND = 1.001
# A way through panes of glass is straight if the cosine of its bend differs from 1 by no more than this.
_UNBENT = 1e-5
# Shadow rays at the first surface of paths that end in a cache.
_SHADOW_RAYS = 2
# With fewer samples, noise of auxiliary features shows in what they guide; each costs a twentieth of a path.
_MIN_AUXILIARY_SPP, _MAX_AUXILIARY_SPP = 4, 16


@dataclass(frozen=True)
class Traced:
    """Means of radiance and of its squares, three (N,) Dr.Jit floats each, and features if asked for."""

    radiance: list[mi.Float]
    squares: list[mi.Float]
    features: AuxiliaryFeatures | None = None


@dataclass(frozen=True)
class Hits:
    """First hits of the rays through the centres of N film positions."""

    distance: NDArray[np.float32]  # (N,) float32, along the unit ray; inf where nothing is hit
    # (N,) float32, the same, continued through flat mirrors and panes to the first rough surface; inf
    # also for the sky in a flat mirror or behind a pane.
    unfolded: NDArray[np.float32]
    shape: NDArray[np.int32]  # (N,) int32, index of the shape in the scene; -1 where nothing is hit

    @property
    def reflected(self) -> NDArray[np.bool_]:
        """(N,) where a flat mirror or a pane shows something else."""
        return self.unfolded > _BEYOND * self.distance


def auxiliary_spp(spp: int) -> int:
    """Samples per pixel of auxiliary features that go with `spp` samples of radiance, 4 to 16."""
    return min(max(spp, _MIN_AUXILIARY_SPP), _MAX_AUXILIARY_SPP)


def features_along(spp: int) -> bool:
    """Whether radiance is traced with the auxiliary features of each of `spp` samples, and not apart."""
    return spp <= _MAX_AUXILIARY_SPP


class Tracer:
    """Traces one scene with Mitsuba's `path` (multiple importance sampling of lights and BSDFs).

    Where thin glass lets shadow rays pass, indirect light is bounded, or the scene has instances, own paths
    of the same kind stand in for it. Where there are participating media, it is `volpath`, always unbiased.

    Args:
        scene: what is traced.
        roulette_depth: depth from which Russian roulette may end a path; that of the scene by default.
        cache: irradiance, in which paths end (pathtrace.trace.cached_paths): less noise in less time, but
            biased.
        most_indirect: bound on what indirect light adds to a path at once (PathSettings), over 0: without
            fireflies, but biased.
    """

    def __init__(
        self,
        scene: Scene,
        roulette_depth: int | None = None,
        cache: IrradianceCache | None = None,
        most_indirect: float | None = None,
    ):
        require_backend()
        self.scene = scene
        depth, roulette = scene.max_depth, roulette_depth or scene.roulette_depth
        kind, hides = "volpath" if scene.optics.has_media else "path", scene.optics.hides_emitters
        paths = {"type": kind, "max_depth": depth, "rr_depth": roulette, "hide_emitters": hides}
        self._path = mi.load_dict(paths)
        self._clear, self._unseen = has_clear_surfaces(scene.mitsuba), Unseen.of(scene.mitsuba, hides)
        # What moves: the numbers by which kernels know a shape, and which samples of it have.
        moving = [] if scene.moving is None else scene.moving.movers()
        self._movers = [(registered(shape), number) for shape, number in moving]
        # In a cache without cells, no path could end.
        known = cache if cache is not None and len(cache.cells) else None
        self._relit = known is not None
        shadow_rays = _SHADOW_RAYS if self._relit else 1
        if (scene.thin_glass or scene.instanced or most_indirect is not None) and not scene.optics.has_media:
            # Mitsuba's `path` has no shadow rays that pass glass, no bound, and code for each instance.
            known = known or IrradianceCache.empty(len(scene.mitsuba.emitters()))
        self._known = known.arrays(scene.mitsuba) if known is not None else None
        self._settings = PathSettings(depth, roulette, shadow_rays, scene.thin_glass, most_indirect)
        radiance = self._radiance if self._known is None else self._cached_radiance
        self._trace_radiance = FrozenWithScenes(radiance)
        self._trace_auxiliary = FrozenWithScenes(self._auxiliary)

    def relight(self, cache: IrradianceCache) -> None:
        """Lets paths end in other light of the cache that this tracer was made with."""
        if self._known is not None and self._relit:
            self._known = cache.relit(self._known)

    def trace(
        self,
        camera: Camera,
        positions: FilmPositions,
        spp: SampleCounts = 1,
        seed: int = 0,
        offset: Offset = 0,
        pattern: int | None = None,
        features: bool = False,
    ) -> Traced:
        """Mean radiance at each position over samples spread evenly over its box; ValueError without samples.

        Args:
            camera, positions: the view, and N film positions in its coordinates.
            spp: samples per position, one number for all, at least 1, or N; those without any are black.
            seed: same seed, same result.
            offset: samples already drawn from each position's sequence, one number for all or N; with the
                same pattern, new samples fill the gaps between those.
            pattern: seed of the sample positions within the boxes; by default `seed`.
            features: whether to return auxiliary features of the samples as well, at less than `auxiliary`
                costs.
        """
        pattern = seed if pattern is None else pattern
        batch = Batch.of(camera, positions, spp, offset, pattern)
        if isinstance(batch.spp, int) and batch.spp < 1:
            raise ValueError(f"spp is {spp}, must be at least 1")
        parts = [self._traced(part, [seed, n], features) for n, part in enumerate(batch.parts(_MAX_LANES))]
        means, first = (joined_channels(list(of_parts)) for of_parts in zip(*parts, strict=True))
        found = AuxiliaryFeatures(means[6:9], means[9:], first[:3], *first[3:]) if features else None
        return Traced(means[:3], means[3:6], found)

    def trace_with_features(
        self, camera: Camera, positions: FilmPositions, spp: int, seed: int
    ) -> tuple[Traced, AuxiliaryFeatures]:
        """`trace`, and auxiliary features of as many samples as go with `spp`."""
        wanted = auxiliary_spp(spp)
        traced = self.trace(camera, positions, spp, seed, features=features_along(spp))
        if traced.features is None:
            return traced, self.auxiliary(camera, positions, wanted, seed)
        if spp == wanted:
            return traced, traced.features
        more = self.auxiliary(camera, positions, wanted - spp, seed, spp)
        return traced, traced.features.averaged(more, (wanted - spp) / wanted)

    def auxiliary(
        self, camera: Camera, positions: FilmPositions, spp: int, pattern: int, offset: Offset = 0
    ) -> AuxiliaryFeatures:
        """Auxiliary features at each position.

        Albedo and normal are means over the same sample positions as `trace` uses, so that they match its
        radiance; position and gloss are those of the first sample. Arguments are as in `trace`.
        """
        batch = Batch.of(camera, positions, spp, offset, pattern)
        # All samples of a position at once, if they fit: their sum is the same however many parts there are.
        most = max(1, _MAX_LANES // int(spp))
        found = joined_channels([self._features(part) for part in batch.parts(most)])
        return AuxiliaryFeatures(found[:3], found[3:6], found[6:9], *found[9:])

    def hits(self, camera: Camera, positions: FilmPositions) -> Hits:
        """First hits of the rays through the centre of each position."""
        whole = Batch.of(camera, positions, 1, 0, 0)
        with interrupted_by_ctrl_c():
            found = [self._hits(camera, part.positions) for part in whole.parts(_MAX_LANES)]
        return Hits(*(np.concatenate([getattr(hits, f.name) for hits in found]) for f in fields(Hits)))

    def _hits(self, camera: Camera, positions: FilmPositions) -> Hits:
        x, y = positions.x + 0.5 * positions.width, positions.y + 0.5 * positions.height
        ray, start = self._clipped(opaque_camera(camera), x, y)
        found = first_hits(self.scene.traced, ray, mi.Bool(True), unseen=self._unseen)
        distance = dr.select(found.surface.is_valid(), found.surface.t + start, dr.inf)
        shapes = mi.UInt32(dr.reinterpret_array(mi.UInt32, found.surface.shape))
        # What is seen in curved mirrors, or refracted as in the edge of a pane, moves with the viewer: it is
        # on the glass rather than as far away as the light has come.
        # Mitsuba has the direction in world space where nothing is hit, in that of the surface elsewhere.
        last = found.last
        back = dr.select(last.is_valid(), last.to_world(last.wi), last.wi)
        unbent = found.flat | (dr.dot(back, ray.d) < _UNBENT - 1)
        beyond = ~found.surface.is_valid() | (~last.is_valid() & unbent)
        unfolded = dr.select(beyond, dr.inf, dr.select(unbent, found.unfolded + start, distance))
        if self.scene.optics.has_media:
            hidden = veil(self.scene.traced, ray, self.scene.optics.medium, mi.Bool(True)).half + start
            distance, unfolded = dr.minimum(distance, hidden), dr.minimum(unfolded, hidden)
        dr.eval(distance, unfolded, shapes)
        registry = {registered(shape): i for i, shape in enumerate(self.scene.mitsuba.shapes())}
        pointers, inverse = np.unique(shapes.numpy(), return_inverse=True)
        index = np.array([registry.get(int(pointer), -1) for pointer in pointers], dtype=np.int32)
        return Hits(distance.numpy(), unfolded.numpy(), index[inverse])

    def _traced(self, batch: Batch, seeds: list[int], features: bool) -> tuple[list[Any], list[Any]]:
        """Means over a batch's samples, and what the first shows, as `_sums`; seeds of frame and part."""
        seed, part = seeds
        sums, first = list[Any](), list[Any]()
        for number, share in enumerate(batch.passes(_MAX_LANES)):
            # The first part has the random numbers of a frame that is traced at once.
            channels, seen = self._sums(share, [seed, number, part] if part else [seed, number], features)
            sums, first = _added(sums, channels), first or seen
        samples = (
            batch.spp if isinstance(batch.spp, int) else mi.Float(dr.maximum(mi.UInt32(batch.spp.each), 1))
        )
        means = sums if batch.spp == 1 else [channel / samples for channel in sums]
        # Single samples alone are not copied from the lanes: whoever shows them finds them there.
        if features or batch.spp != 1:
            dr.eval(means, first)
        return means, first

    def _features(self, batch: Batch) -> list[Any]:
        """Albedo, normal, position, gloss and, where something moves, mover of a batch."""
        sums, first = list[Any](), list[Any]()
        for share in batch.passes(_MAX_LANES):
            features = self._trace_auxiliary(self.scene.traced, *share.rays())
            dr.eval(features)
            sums = _added(sums, share.lanes.sums([*features.albedo, *features.normal]), first)
            first = first or [
                dr.gather(mi.Float, channel, share.lanes.first) for channel in features.of_first
            ]
        found = [*(channel / batch.spp for channel in sums), *first]
        dr.eval(found)
        return found

    def _sums(self, batch: Batch, seeds: list[int], features: bool) -> tuple[list[Any], list[Any]]:
        """What each position's samples of a pass add up to, and what the first of them shows, (N,) each.

        Sums of radiance and of its squares, and with `features` of albedo and normal; with `features`,
        position, gloss and, where something moves, mover.
        """
        # Seeds of different frames and passes must not overlap; numpy's seed sequence mixes them.
        state = mixed_seeds(seeds)
        if self._known is None:
            channels = self._trace_radiance(features, self.scene.traced, state, *batch.rays())
        else:
            # Unbiased paths only need the film positions of it.
            sampled = batch.sequences, *batch.rays(batch.sequences)
            channels = self._trace_radiance(features, self.scene.traced, state, self._known, *sampled)
        dr.eval(channels)
        radiance, means, first = channels[:3], channels[3:9], channels[9:]
        lanes = batch.lanes
        if batch.spp == 1:
            # A sample is its own sum, which is squared in the kernel that comes next.
            radiance, means = (lanes.sums(of) for of in (radiance, means))
        sums = [*radiance, *(dr.square(channel) for channel in radiance), *means]
        if batch.spp != 1:
            sums = lanes.sums(sums)
        return sums, [dr.gather(mi.Float, channel, lanes.first) for channel in first]

    def _radiance(self, features: bool, scene: AnyScene, state: mi.UInt32, *lanes: dr.ArrayBase) -> list[Any]:
        """Radiance of each lane, and what it sees first; frozen, with the lanes of `Batch.rays`."""
        ray, active = self._rays(*lanes)
        sampler = random_numbers(state, dr.width(active))
        radiance, _, _ = self._path.sample(scene, sampler, ray, self.scene.optics.medium, active)
        return _evaluated(radiance, sampler, self._seen(scene, ray, active) if features else None)

    def _cached_radiance(
        self,
        features: bool,
        scene: AnyScene,
        state: mi.UInt32,
        cache: CacheArrays,
        sequences: Sequences,
        *lanes: dr.ArrayBase,
    ) -> list[Any]:
        """Radiance of each lane by paths that end in the cache, and what it sees first; frozen."""
        ray, active = self._rays(*lanes)
        sampler = random_numbers(state, dr.width(active))
        seen = auxiliary_hits(scene, ray, active, self._clear and features, self._unseen)
        shown = active & seen.surface.is_valid() if self.scene.optics.hides_emitters else active
        paths = scene, sampler, ray, seen.surface, shown, self._settings, sequences, cache
        radiance = path_radiance(*paths)
        return _evaluated(radiance, sampler, self._seen(scene, ray, active, seen) if features else None)

    def _auxiliary(self, scene: AnyScene, *lanes: dr.ArrayBase) -> AuxiliaryFeatures:
        features = self._seen(scene, *self._rays(*lanes))
        dr.eval(features)
        return features

    def _rays(self, x: mi.Float, y: mi.Float, active: mi.Bool, camera: mi.Float) -> tuple[mi.Ray3f, mi.Bool]:
        ray, _ = self._clipped(camera, x, y)
        return ray, active

    def _clipped(self, camera: mi.Float, x: mi.Float, y: mi.Float) -> tuple[mi.Ray3f, mi.Float]:
        """Rays through film coordinates between the clipping planes, and how far from the eye they start."""
        ray, clips = ray_through(camera, x, y), self.scene.optics.clips
        return (ray, mi.Float(0)) if clips is None else clipped(ray, camera, clips)

    def _seen(
        self, scene: AnyScene, ray: mi.Ray3f, active: mi.Bool, hits: FirstHits | None = None
    ) -> AuxiliaryFeatures:
        """Auxiliary features; albedo and normal that are not finite, as of damaged textures, count as 0."""
        hits = hits or auxiliary_hits(scene, ray, active, self._clear, self._unseen)
        found = auxiliary_features(hits, ray, active, self._movers)
        if self.scene.optics.has_media:
            found = veil(scene, ray, self.scene.optics.medium, active).over(found, ray)
        albedo, normal = (
            [dr.select(dr.isfinite(channel), channel, 0) for channel in channels]
            for channels in (found.albedo, found.normal)
        )
        return replace(found, albedo=albedo, normal=normal)


def _evaluated(radiance: mi.Color3f, sampler: mi.Sampler, seen: AuxiliaryFeatures | None) -> list[Any]:
    """Three channels of radiance and those of auxiliary features, if there are any; computed."""
    # A sample that is not finite counts as black: it would spoil its pixel's mean.
    radiance = dr.select(dr.all(dr.isfinite(radiance)), radiance, 0)
    # Without this evaluation, every later step would trace its own paths: three to four times the work.
    sampler.schedule_state()
    channels = list(radiance)
    if seen is not None:
        channels += [*seen.albedo, *seen.normal, *seen.of_first]
    dr.eval(channels)
    return channels


def _added(sums: list[Any], channels: list[Any], *others: object) -> list[Any]:
    """Channels added to sums, if there are any, in one kernel with others."""
    if not sums:
        return channels
    added = [a + b for a, b in zip(sums, channels, strict=True)]
    dr.eval(added, others)
    return added
