"""Radiance and geometry at any list of film positions: a disc, a frame and a warped grid are one call.

Everything that changes from frame to frame (camera, positions, seed) enters the traced functions as
an evaluated array, so that a moving gaze or camera neither traces Python again nor compiles anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.view import Camera
from pathtrace.scene import Scene

# Lanes are padded to a multiple of this with masked ones: a frozen function records again when the
# divisibility of its width changes, and masked lanes at the end cost next to nothing.
_LANE_MULTIPLE = 4096
# Lanes traced at once: bounds the memory that many samples over a large frame would take.
_MAX_LANES = 1 << 22
_RUSSIAN_ROULETTE_DEPTH = 5
_AOVS = "albedo:albedo,normal:sh_normal,place:position,shape:shape_index"
# Where nothing is hit, the sky is this far away.
_FAR = 1e5
_GOLDEN = 0.6180339887498949
_MAX_MIRRORS = 8


@dataclass(frozen=True)
class FilmPositions:
    """Places on the film to trace, each a unit box filter in pixels.

    Attributes:
        x, y: (N,) Dr.Jit floats, upper left corner of each box; a pixel's corner is its column and row.
    """

    x: Any
    y: Any

    @property
    def count(self) -> int:
        return dr.width(self.x)


@dataclass(frozen=True)
class Traced:
    """What was traced at N film positions.

    Attributes:
        radiance: three (N,) Dr.Jit floats, linear, unbounded.
        albedo: three (N,) floats, only with guides.
        normal: three (N,) floats, shading normal in world space, only with guides.
        squares: three (N,) floats, mean of the samples' squared radiance, only with guides.
        place: three (N,) floats, where the first of the samples met a surface, only with guides.
        gloss: (N,) unsigned integers, only with guides: 0 where that surface is matt, 1 where it is glossy, 2
            where it is a mirror or glass.
    """

    radiance: list[Any]
    albedo: list[Any] | None = None
    normal: list[Any] | None = None
    squares: list[Any] | None = None
    place: list[Any] | None = None
    gloss: Any | None = None


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


def pixel_positions(indices: Any, width: int) -> FilmPositions:
    """Film positions of pixels given by their row-major index, a (N,) Dr.Jit unsigned integer array."""
    row = indices // width
    positions = FilmPositions(mi.Float(indices - row * width), mi.Float(row))
    dr.eval(positions.x, positions.y)
    return positions


def frame_positions(camera: Camera) -> FilmPositions:
    """Film positions of all pixels, row by row."""
    return pixel_positions(dr.arange(mi.UInt32, camera.width * camera.height), camera.width)


def _opaque_camera(camera: Camera) -> tuple[Any, ...]:
    """Origin and the three vectors that turn film coordinates into a ray: d ~ x ax + y ay + az."""
    pose = camera.camera_to_world
    ax = pose[:3, 0] / camera.fx
    ay = pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    origin, *axes = (vector.tolist() for vector in (pose[:3, 3], ax, ay, az))
    vectors = mi.Point3f(*origin), *(mi.Vector3f(*axis) for axis in axes)
    dr.make_opaque(vectors)
    return vectors


def _registered(shape: Any) -> int:
    """The number by which kernels know a shape."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _gloss(flags: int) -> int:
    if mi.has_flag(flags, mi.BSDFFlags.Delta):
        return 2
    return int(mi.has_flag(flags, mi.BSDFFlags.Glossy))


@dataclass(frozen=True)
class _Lanes:
    """Which lane traces which sample of which position; the samples of a position lie side by side.

    Attributes:
        count: lanes in use; the others pad.
        active: which those are.
        index, step: position and number of the sample in it, of each lane.
        stride: one over the position's samples.
        first: (N,) lane of each position's first sample.
        spp: samples per position.
    """

    count: int
    active: Any
    index: Any
    step: Any
    stride: Any
    first: Any
    spp: int | NDArray[np.int64]

    @staticmethod
    def of(positions: int, spp: int | NDArray[np.int64]) -> _Lanes:
        """Lanes for so many samples of each position."""
        count = positions * spp if isinstance(spp, int) else int(spp.sum())
        padded = -(-count // _LANE_MULTIPLE) * _LANE_MULTIPLE
        lane = dr.arange(mi.UInt32, padded)
        active = lane < dr.opaque(mi.UInt32, count)
        if isinstance(spp, int):
            index = lane // spp
            stride = dr.opaque(mi.Float, 1 / spp)
            first = dr.arange(mi.UInt32, positions) * spp
            return _Lanes(count, active, index, mi.Float(lane - index * spp), stride, first, spp)
        first = mi.UInt32(np.cumsum(spp) - spp)
        index = mi.UInt32(np.pad(np.repeat(np.arange(positions), spp), (0, padded - count)))
        stride = dr.gather(mi.Float, mi.Float(1 / np.maximum(spp, 1)), index)
        step = mi.Float(lane - dr.gather(mi.UInt32, first, index))
        return _Lanes(count, active, index, step, stride, first, spp)

    def added_up(self, channel: Any) -> Any:
        """(N,) sums over each position's samples."""
        if isinstance(self.spp, int):
            return channel if self.spp == 1 else dr.block_sum(channel, self.spp)
        # A pass may have no sample for a position.
        before = np.concatenate([[0.0], np.cumsum(channel.numpy(), dtype=np.float64)])
        first = self.first.numpy()
        return mi.Float(before[first + self.spp] - before[first])


class Tracer:
    """Traces one scene with Mitsuba's `path` (multiple importance sampling of lights and BSDFs).

    Args:
        scene: what to trace.
        max_depth: path depth; the scene's own by default.
    """

    def __init__(self, scene: Scene, max_depth: int | None = None):
        self.scene = scene
        depth = max_depth or scene.max_depth
        path = {"type": "path", "max_depth": depth, "rr_depth": _RUSSIAN_ROULETTE_DEPTH}
        self._path = mi.load_dict(path)
        self._path_and_guides = mi.load_dict({"type": "aov", "aovs": _AOVS, "image": path})
        gloss = {_registered(shape): _gloss(shape.bsdf().flags()) for shape in scene.mitsuba.shapes()}
        self._gloss = mi.UInt32([gloss.get(number, 0) for number in range(max(gloss) + 1)])
        # One frozen function per tracer: the scene is part of what was recorded.
        self._trace_radiance = dr.freeze(self._radiance)
        self._trace_guides = dr.freeze(self._radiance_and_guides)

    def trace(
        self,
        camera: Camera,
        positions: FilmPositions,
        spp: int | NDArray[np.int64] = 1,
        seed: int = 0,
        guides: bool = False,
    ) -> Traced:
        """Mean over `spp` samples at each position, stratified over its box.

        Args:
            camera: the view; its film coordinates are those of `positions`.
            positions: N places.
            spp: samples per position, the same for all or (N,) at least 1 each.
            seed: same seed, same result.
            guides: also return what denoising and fusion want to know.
        """
        most = int(np.max(spp))
        lanes = positions.count * spp if isinstance(spp, int) else int(spp.sum())
        passes = min(most, -(-lanes // _MAX_LANES))
        sums: list[Any] = []
        first: list[Any] = []
        for number in range(passes):
            # As even as whole numbers can be, and never none of a position's in the first pass.
            share = (spp * (number + 1) + passes - 1) // passes - (spp * number + passes - 1) // passes
            channels, hit = self._pass(camera, positions, share, seed, number, guides)
            sums = [a + b for a, b in zip(sums, channels, strict=True)] if sums else channels
            first = first or hit
            dr.eval(sums, first)
        samples = spp if isinstance(spp, int) else mi.Float(spp)
        means = [channel / samples for channel in sums]
        dr.eval(means)
        if not guides:
            return Traced(means)
        gloss = dr.gather(mi.UInt32, self._gloss, mi.UInt32(first[3]), first[3] >= 0)
        dr.eval(gloss)
        return Traced(means[0:3], means[3:6], means[6:9], means[9:12], first[:3], gloss)

    def hits(self, camera: Camera, positions: FilmPositions) -> Hits:
        """First hits of the rays through the middle of each position."""
        origin, ax, ay, az = _opaque_camera(camera)
        direction = dr.normalize(dr.fma(ax, positions.x + 0.5, dr.fma(ay, positions.y + 0.5, az)))
        scene = self.scene.mitsuba
        surface = scene.ray_intersect(mi.Ray3f(origin, direction))
        valid = surface.is_valid()
        distance = dr.select(valid, surface.t, dr.inf)
        shapes = dr.reinterpret_array(mi.UInt32, surface.shape)
        total = mi.Float(distance)
        alive = mi.Bool(valid)
        for _ in range(_MAX_MIRRORS):
            bsdf = surface.bsdf()
            alive &= ~mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth) & valid
            # A first sample next to 1 takes a dielectric's transmission, a mirror has one lobe only.
            sample, weight = bsdf.sample(mi.BSDFContext(), surface, 0.999, mi.Point2f(0.5), alive)
            alive &= dr.max(weight) > 0
            surface = scene.ray_intersect(surface.spawn_ray(surface.to_world(sample.wo)), alive)
            alive &= surface.is_valid()
            total = dr.select(alive, total + surface.t, total)
        dr.eval(distance, total, shapes)
        registry = {_registered(shape): i for i, shape in enumerate(scene.shapes())}
        pointers, inverse = np.unique(shapes.numpy(), return_inverse=True)
        index = np.array([registry.get(int(pointer), -1) for pointer in pointers], dtype=np.int32)
        return Hits(distance.numpy(), total.numpy(), index[inverse])

    def _pass(
        self,
        camera: Camera,
        positions: FilmPositions,
        spp: int | NDArray[np.int64],
        seed: int,
        number: int,
        guides: bool,
    ) -> tuple[list[Any], list[Any]]:
        """Sums over the samples, and place and shape of the first of them: one array of N per channel."""
        lanes = _Lanes.of(positions.count, spp)
        # Seeds of different frames and passes must not overlap; numpy's seed sequence mixes them.
        mixed = np.random.SeedSequence([seed, number]).generate_state(3).tolist()
        state, *shifts = (dr.opaque(mi.UInt32, value) for value in mixed)
        # A lattice over each box, shifted at random (Cranley and Patterson 1976): unbiased as independent
        # places are, but edges and textures, and with them the guides, have far less noise.
        u = dr.fma(lanes.step, lanes.stride, mi.sample_tea_float32(lanes.index, shifts[0]))
        v = dr.fma(lanes.step, _GOLDEN, mi.sample_tea_float32(lanes.index, shifts[1]))
        x = dr.gather(mi.Float, positions.x, lanes.index, lanes.active) + (u - dr.floor(u))
        y = dr.gather(mi.Float, positions.y, lanes.index, lanes.active) + (v - dr.floor(v))
        active = lanes.active
        dr.eval(x, y, active)
        function = self._trace_guides if guides else self._trace_radiance
        channels = function(self.scene.mitsuba, x, y, active, state, *_opaque_camera(camera))
        dr.eval(channels)
        samples = [dr.gather(mi.Float, c, dr.arange(mi.UInt32, lanes.count)) for c in channels[:9]]
        if not guides:
            return [lanes.added_up(c) for c in samples], []
        samples += [dr.square(c) for c in samples[:3]]
        first = [dr.gather(mi.Float, c, lanes.first) for c in channels[9:]]
        return [lanes.added_up(c) for c in samples], first

    @staticmethod
    def _sample(integrator: Any, scene: Any, x: Any, y: Any, active: Any, seed: Any, camera: Any) -> Any:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, dr.width(x))
        origin, ax, ay, az = camera
        direction = dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az)))
        ray = mi.RayDifferential3f(origin, direction)
        radiance, _, aovs = integrator.sample(scene, sampler, ray, active=active)
        # A sample that is not finite counts as black; kept, it would spoil its pixel's mean for good.
        finite = dr.all(dr.isfinite(radiance))
        radiance = dr.select(finite, radiance, 0)
        # Without this evaluation every later step traces its own paths, three to four times the work.
        sampler.schedule_state()
        return radiance, aovs, ray

    def _radiance(self, scene: Any, x: Any, y: Any, active: Any, seed: Any, *camera: Any) -> list[Any]:
        radiance, _, _ = self._sample(self._path, scene, x, y, active, seed, camera)
        channels = [radiance.x, radiance.y, radiance.z]
        dr.eval(channels)
        return channels

    def _radiance_and_guides(
        self, scene: Any, x: Any, y: Any, active: Any, seed: Any, *camera: Any
    ) -> list[Any]:
        radiance, aovs, ray = self._sample(self._path_and_guides, scene, x, y, active, seed, camera)
        *shading, px, py, pz, shape = aovs[-10:]
        hit = dr.squared_norm(mi.Vector3f(*shading[3:])) > 0
        place = dr.select(hit, mi.Point3f(px, py, pz), ray(_FAR))
        channels = [*radiance, *shading, *place, dr.select(hit, shape, -1)]
        dr.eval(channels)
        return channels
