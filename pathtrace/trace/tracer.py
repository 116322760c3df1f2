"""Radiance and geometry at any list of film positions: a disc, a frame and a warped grid are one call.

Everything that changes from frame to frame (camera, positions, seed) enters the traced functions as
an evaluated array, so that a moving gaze or camera neither traces Python again nor compiles anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import FilmPositions
from pathtrace.trace.first_hit import auxiliary, has_clear_surfaces, look
from pathtrace.trace.lanes import Lanes
from pathtrace.trace.rays import opaque_camera, ray_through

# Lanes traced at once: bounds the memory that many samples over a large frame would take.
_MAX_LANES = 1 << 22
RUSSIAN_ROULETTE_DEPTH = 5
# Places of a pixel where albedo and normal are looked up. With fewer, the auxiliary features' own noise shows in what
# they guide; each costs a twentieth of a path.
_LEAST_PLACES, _MOST_PLACES = 4, 16


@dataclass(frozen=True)
class Traced:
    """What was traced at N film positions.

    Attributes:
        radiance: three (N,) Dr.Jit floats, linear, unbounded.
        squares: three (N,) floats, mean of the samples' squared radiance.
    """

    radiance: list[Any]
    squares: list[Any]


@dataclass(frozen=True)
class AuxiliaryFeatures:
    """What denoising and fusion want to know of N film positions.

    Attributes:
        albedo: three (N,) Dr.Jit floats.
        normal: three (N,) floats, shading normal in world space.
        place: three (N,) floats, where what the first of the rays sees seems to be: on the surface that it
            meets, or behind a flat mirror.
        gloss: (N,) floats: pathtrace.sight's MATT, GLOSSY or SPECULAR, of that.
    """

    albedo: list[Any]
    normal: list[Any]
    place: list[Any]
    gloss: Any


@dataclass(frozen=True)
class Hits:
    """What the rays through the middle of N film positions meet first.

    Attributes:
        distance: (N,) numpy float32, along the unit ray; inf where nothing is hit.
        unfolded: (N,) the same, continued through smooth mirrors and glass to the first rough surface:
            where the thing seen in a mirror seems to be.
        shape: (N,) numpy int32, index of the shape in the scene, -1 where nothing is hit.
    """

    distance: NDArray[np.float32]
    unfolded: NDArray[np.float32]
    shape: NDArray[np.int32]


def auxiliary_spp(spp: int) -> int:
    """Of how many places auxiliary features should be means, beside so many samples per pixel."""
    return min(max(spp, _LEAST_PLACES), _MOST_PLACES)


class Tracer:
    """Traces one scene with Mitsuba's `path` (multiple importance sampling of lights and BSDFs).

    Args:
        scene: what to trace.
        max_depth: path depth; the scene's own by default.
        roulette_depth: from which depth on paths are ended by Russian roulette: the earlier, the quicker a
            sample, and the noisier.
    """

    def __init__(
        self, scene: Scene, max_depth: int | None = None, roulette_depth: int = RUSSIAN_ROULETTE_DEPTH
    ):
        self.scene = scene
        depth = max_depth or scene.max_depth
        self._path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": roulette_depth})
        self._clear = has_clear_surfaces(scene.mitsuba)
        # Frozen functions of this tracer: the scene is part of what was recorded.
        self._trace_radiance = dr.freeze(self._radiance)
        self._trace_auxiliary = dr.freeze(self._auxiliary)

    def trace(
        self,
        camera: Camera,
        positions: FilmPositions,
        spp: int | NDArray[np.int64] = 1,
        seed: int = 0,
        taken: int | NDArray[np.int64] = 0,
        pattern: int | None = None,
    ) -> Traced:
        """Mean over `spp` samples at each position, spread evenly over its box.

        Args:
            camera: the view; its film coordinates are those of `positions`.
            positions: N places.
            spp: samples per position, the same for all or (N,) at least 1 each.
            seed: same seed, same result.
            taken: samples that each position already has; with the same pattern, these go where those left
                gaps.
            pattern: of the places of samples in their boxes; by default the seed's own.
        """
        most = int(np.max(spp))
        lanes = positions.count * spp if isinstance(spp, int) else int(spp.sum())
        passes = min(most, -(-lanes // _MAX_LANES))
        sums: list[Any] = []
        done = spp * 0
        for number in range(passes):
            # As even as whole numbers can be, and never none of a position's in the first pass.
            share = (spp * (number + 1) + passes - 1) // passes - done
            lattice = _Lattice(camera, positions, share, taken + done, seed if pattern is None else pattern)
            channels = self._pass(lattice, seed, number)
            sums = [a + b for a, b in zip(sums, channels, strict=True)] if sums else channels
            done = done + share
            dr.eval(sums)
        samples = spp if isinstance(spp, int) else mi.Float(spp)
        means = [channel / samples for channel in sums]
        dr.eval(means)
        return Traced(means[:3], means[3:])

    def auxiliary(
        self,
        camera: Camera,
        positions: FilmPositions,
        places: int,
        pattern: int,
        taken: int | NDArray[np.int64] = 0,
    ) -> AuxiliaryFeatures:
        """Means over so many places of each position: those of samples, so that they fit together.

        Args:
            camera, positions: as in `trace`.
            places: how many.
            pattern, taken: as in `trace`: the first ray is that of the next sample.
        """
        lattice = _Lattice(camera, positions, places, taken, pattern)
        channels = self._trace_auxiliary(self.scene.mitsuba, *lattice.rays())
        dr.eval(channels)
        means = [lattice.lanes.added_up(c) / places for c in channels[:6]]
        first = [dr.gather(mi.Float, c, lattice.lanes.first) for c in channels[6:]]
        dr.eval(means, first)
        return AuxiliaryFeatures(means[:3], means[3:], first[:3], first[3])

    def hits(self, camera: Camera, positions: FilmPositions) -> Hits:
        """First hits of the rays through the middle of each position."""
        ray = ray_through(
            opaque_camera(camera), positions.x + 0.5 * positions.width, positions.y + 0.5 * positions.height
        )
        sight = look(self.scene.mitsuba, ray, mi.Bool(True))
        distance = dr.select(sight.surface.is_valid(), sight.surface.t, dr.inf)
        shapes = dr.reinterpret_array(mi.UInt32, sight.surface.shape)
        unfolded = dr.select(sight.surface.is_valid(), sight.unfolded, dr.inf)
        dr.eval(distance, unfolded, shapes)
        registry = {_registered(shape): i for i, shape in enumerate(self.scene.mitsuba.shapes())}
        pointers, inverse = np.unique(shapes.numpy(), return_inverse=True)
        index = np.array([registry.get(int(pointer), -1) for pointer in pointers], dtype=np.int32)
        return Hits(distance.numpy(), unfolded.numpy(), index[inverse])

    def _pass(self, lattice: _Lattice, seed: int, number: int) -> list[Any]:
        """Sums over the samples of radiance and its squares: six arrays of N."""
        # Seeds of different frames and passes must not overlap; numpy's seed sequence mixes them.
        state = dr.opaque(mi.UInt32, int(np.random.SeedSequence([seed, number]).generate_state(1)[0]))
        channels = self._trace_radiance(self.scene.mitsuba, state, *lattice.rays())
        dr.eval(channels)
        return [lattice.lanes.added_up(c) for c in (*channels, *(dr.square(c) for c in channels))]

    def _radiance(self, scene: Any, state: Any, x: Any, y: Any, active: Any, *camera: Any) -> list[Any]:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(state, dr.width(x))
        radiance, _, _ = self._path.sample(scene, sampler, ray_through(camera, x, y), active=active)
        # A sample that is not finite counts as black; kept, it would spoil its pixel's mean for good.
        finite = dr.all(dr.isfinite(radiance))
        radiance = dr.select(finite, radiance, 0)
        # Without this evaluation every later step traces its own paths, three to four times the work.
        sampler.schedule_state()
        channels = [radiance.x, radiance.y, radiance.z]
        dr.eval(channels)
        return channels

    def _auxiliary(self, scene: Any, x: Any, y: Any, active: Any, *camera: Any) -> list[Any]:
        channels = auxiliary(scene, ray_through(camera, x, y), active, self._clear)
        dr.eval(channels)
        return channels


@dataclass(frozen=True)
class _Lattice:
    """Where samples go: so many at each position, after those it already has."""

    camera: Camera
    positions: FilmPositions
    spp: int | NDArray[np.int64]
    taken: int | NDArray[np.int64]
    pattern: int

    @cached_property
    def lanes(self) -> Lanes:
        return Lanes.of(self.positions.count, self.spp)

    def rays(self) -> tuple[Any, ...]:
        """Film coordinates, mask and camera of all lanes, as the traced functions take them."""
        lanes = self.lanes
        mixed = int(np.random.SeedSequence(self.pattern).generate_state(1)[0])
        if isinstance(self.taken, int):
            taken = dr.opaque(mi.UInt32, self.taken)
        else:
            taken = mi.UInt32(self.taken.astype(np.uint32))
        x, y = lanes.places(self.positions, taken, dr.opaque(mi.UInt32, mixed))
        active = lanes.active
        dr.eval(x, y, active)
        return x, y, active, *opaque_camera(self.camera)


def _registered(shape: Any) -> int:
    """The number by which kernels know a shape."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])
