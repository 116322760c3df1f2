"""Film positions, a camera's rays through them, and their samples: numbers, Sobol sequences, lanes."""

from __future__ import annotations

import atexit
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, TypeAlias, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from numpy.typing import NDArray
from torch.quasirandom import SobolEngine

from compose.base.arrays import constant, uploaded
from compose.base.traced_samples import Counts
from compose.camera.camera import Camera

# Numbers of N film positions: of their samples, and of those drawn before; one for all, or one of each.
SampleCounts = int | NDArray[np.int64] | Counts
Offset: TypeAlias = "int | NDArray[np.integer] | mi.UInt32"

# After so many points a sequence restarts, scrambled otherwise.
_LOG2_LENGTH = 12
# Pairs of dimensions: positions on the film, points on lights, directions of scattering.
FILM, LIGHT, SCATTERING = range(3)
_PAIRS = 3
# Keeps the scramblings of different pairs apart.
_PAIR_STEP = 0x9E3779B9
# Of the hash that scrambles each pair. Four leave a pattern where neighbouring positions differ in one word.
_ROUNDS = (4, 8, 8)
# Lanes are padded to a multiple of this with masked ones: a frozen function is recorded again when the
# divisibility of its width changes, and masked lanes at the end cost next to nothing.
_LANE_MULTIPLE = 4096
_Values = TypeVar("_Values")


@dataclass(frozen=True)
class FilmPositions:
    """N positions on the film, each a box over which samples are averaged."""

    x: mi.Float  # (N,) left of each; a pixel's is its column
    y: mi.Float  # (N,) top of each; a pixel's is its row
    width: mi.Float | float = 1.0  # in pixels, one for all or (N,)
    height: mi.Float | float = 1.0

    @property
    def count(self) -> int:
        """N, the number of positions."""
        return dr.width(self.x)

    def taken(self, index: mi.UInt32) -> FilmPositions:
        """Some of the positions, by their indices."""
        of = lambda values: dr.gather(mi.Float, values, index)  # noqa: E731
        sizes = (of(size) if dr.width(size) > 1 else size for size in (self.width, self.height))
        found = FilmPositions(of(self.x), of(self.y), *sizes)
        dr.eval(found.x, found.y)
        return found


def pixel_positions(indices: mi.UInt32, width: int) -> FilmPositions:
    """Film positions of pixels of a frame of some width, from their row-major indices (N,), mi.UInt32."""
    # Opaque, like everything that may change from frame to frame: a literal would be compiled in.
    columns = constant(mi.UInt32, width)
    row = indices // columns
    positions = FilmPositions(mi.Float(indices - row * columns), mi.Float(row))
    dr.eval(positions.x, positions.y)
    return positions


def box_positions(*sides: NDArray[np.floating]) -> FilmPositions:
    """Film positions of N boxes from (N,) numbers in pixels: left and top, width and height."""
    return FilmPositions(*(mi.Float(values.astype(np.float32)) for values in sides))


def frame_positions(camera: Camera) -> FilmPositions:
    """Film positions of all H * W pixels of a camera's frame, row by row."""
    return pixel_positions(dr.arange(mi.UInt32, camera.width * camera.height), camera.width)


def interleaved(channels: list[Any]) -> NDArray[np.float32]:
    """(N, 3) array from three (N,) Dr.Jit floats, in one kernel, which is quicker than numpy."""
    values: Any = dr.ravel(mi.Point3f(*channels))
    return values.numpy().reshape(-1, 3)


def opaque_camera(camera: Camera) -> mi.Float:
    """A camera as one evaluated Dr.Jit array of vectors: origin, ax, ay and az.

    The ray through film coordinates (x, y) has the direction x ax + y ay + az. A new camera changes the
    vectors' values only, so that frozen functions are not recorded again.
    """
    pose = camera.camera_to_world
    ax, ay = pose[:3, 0] / camera.fx, pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    return uploaded(mi.Float, np.array([pose[:3, 3], ax, ay, az], dtype=np.float32))


def ray_through(
    camera: mi.Float, x: mi.Float, y: mi.Float, number: mi.UInt32 | int = 0
) -> mi.RayDifferential3f:
    """Rays of an `opaque_camera`, or of several by their `number`, through film coordinates x and y, (N,)."""
    values = [dr.gather(mi.Float, camera, 12 * number + i) for i in range(12)]
    origin = mi.Point3f(*values[:3])
    ax, ay, az = (mi.Vector3f(*values[i : i + 3]) for i in (3, 6, 9))
    return mi.RayDifferential3f(origin, dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az))))


def clipped(
    ray: mi.Ray3f, camera: mi.Float, clips: tuple[float, float]
) -> tuple[mi.RayDifferential3f, mi.Float]:
    """Rays of an `opaque_camera` between planes at two depths, and how far from the eye they start, (N,)."""
    ax, ay = (mi.Vector3f(*[dr.gather(mi.Float, camera, i + k) for k in range(3)]) for i in (3, 6))
    # Length along a ray per unit of depth.
    length = dr.rcp(dr.abs(dr.dot(ray.d, dr.normalize(dr.cross(ax, ay)))))
    near, far = (length * clip for clip in clips)
    within = mi.RayDifferential3f(ray(near), ray.d)
    within.maxt = far - near
    return within, near


def sobol_tables() -> list[Any]:
    """The Sobol points as Dr.Jit arrays of 32-bit fixed-point fractions, one for each dimension."""
    return _tables(mi.variant())


@cache
def _tables(variant: str) -> list[Any]:
    # SciPy's are the same, and take a third of a second to import.
    points = SobolEngine(2 * _PAIRS).draw(1 << _LOG2_LENGTH, dtype=torch.float64).numpy()
    return [mi.UInt32(column) for column in np.ascontiguousarray((points.T * 2.0**32).astype(np.uint32))]


# Dr.Jit complains of arrays that outlive it.
atexit.register(_tables.cache_clear)


@dataclass(frozen=True)
class Sequences:
    """The sequences of N lanes, scrambled by a random digital shift each (Kollig and Keller 2002).

    They are unbiased, but edges, soft shadows and auxiliary features have far less noise, and later samples
    fill the gaps that earlier ones left.
    """

    tables: list[mi.UInt32]  # of `sobol_tables`
    number: mi.UInt32  # (N,) number of each lane's sample in its sequence
    scramble: tuple[mi.UInt32, mi.UInt32]  # two (N,) Dr.Jit integers that select the scrambling

    def point(self, pair: int, number: mi.UInt32) -> tuple[Any, Any]:
        """Coordinates in 0..1 of each sequence's point of a number (N,), in one pair of dimensions."""
        restarts = number >> _LOG2_LENGTH
        one, other = self.scramble
        shifts = mi.sample_tea_32(one, other + restarts + ((pair * _PAIR_STEP) & 0xFFFFFFFF), _ROUNDS[pair])
        index = number & ((1 << _LOG2_LENGTH) - 1)
        # 24 of the 32 bits: as many as a float in 0..1 holds without being rounded to 1.
        x, y = (
            mi.Float((dr.gather(mi.UInt32, table, index) ^ shift) >> 8) * 2**-24
            for table, shift in zip(self.tables[2 * pair : 2 * pair + 2], shifts, strict=True)
        )
        return x, y


@dataclass(frozen=True)
class Lanes:
    """Assignment of lanes to samples; the samples of a position lie side by side."""

    count: int  # lanes in use; the others are padding
    active: mi.Bool  # mask of the lanes in use
    index: mi.UInt32  # film position of each lane
    sample: mi.UInt32  # number of each lane's sample among those of its position, from 0
    first: mi.UInt32  # (N,) lane of each position's first sample
    spp: int | Counts  # samples per position, one number for all or Counts of N positions

    @staticmethod
    def of(positions: int, spp: int | Counts) -> Lanes:
        """Lanes for `spp` samples of each of a number of positions, some of which may have none."""
        count = positions * spp if isinstance(spp, int) else spp.total
        padded = max(1, -(-count // _LANE_MULTIPLE)) * _LANE_MULTIPLE
        lane = dr.arange(mi.UInt32, padded)
        active = lane < constant(mi.UInt32, count)
        if isinstance(spp, int):
            index = lane // spp
            first = dr.arange(mi.UInt32, positions) * spp
            return Lanes(count, active, index, lane - index * spp, first, spp)
        each = mi.UInt32(spp.each)
        start = dr.prefix_sum(each)
        # Each run of lanes starts with its position's number, which holds until the next run.
        marks = dr.zeros(mi.UInt32, padded)
        dr.scatter(marks, dr.arange(mi.UInt32, positions), start, each > 0)
        index = dr.prefix_reduce(dr.ReduceOp.Max, marks, exclusive=False)
        # A position without samples has no lane; it must not point beyond the last one either.
        first = dr.minimum(start, constant(mi.UInt32, max(count - 1, 0)))
        dr.eval(first, index)
        sample = lane - dr.gather(mi.UInt32, first, index, active)
        return Lanes(count, active, index, sample, first, spp)

    def sequences(self, positions: FilmPositions, offset: mi.UInt32, pattern: mi.UInt32) -> Sequences:
        """The Sobol sequences of positions, of which `offset` samples, one number or (N,), were drawn."""
        x, y = (dr.reinterpret_array(mi.UInt32, self._gathered(side)) for side in (positions.x, positions.y))
        if dr.width(offset) > 1:
            offset = self._gathered(offset)
        return Sequences(sobol_tables(), self.sample + offset, (x, y + pattern))

    def sample_positions(self, positions: FilmPositions, sequences: Sequences) -> tuple[Any, Any]:
        """Film coordinates (x, y) of each lane's sample in its box."""
        unit = sequences.point(FILM, sequences.number)
        corner = self._gathered(positions.x), self._gathered(positions.y)
        sides = positions.width, positions.height
        sizes = (self._gathered(side) if dr.width(side) > 1 else side for side in sides)
        x, y = (start + size * share for start, size, share in zip(corner, sizes, unit, strict=True))
        return x, y

    def _gathered(self, values: _Values) -> _Values:
        return dr.gather(type(values), values, self.index, self.active)

    def sums(self, channels: list[Any]) -> list[Any]:
        """(N,) sums of each channel, one value per lane, over the samples of each position alone."""
        # One kernel, even if the channels have not been computed yet.
        dr.eval(channels)
        if self.spp == 1:
            used = dr.arange(mi.UInt32, self.count)
            return [dr.gather(mi.Float, channel, used) for channel in channels]
        each = constant(mi.UInt32, self.spp) if isinstance(self.spp, int) else mi.UInt32(self.spp.each)
        end = self.first + each

        def add(lane: mi.UInt32, sums: list[Any]) -> tuple[Any, list[Any]]:
            values = (mi.Float64(dr.gather(mi.Float, channel, lane)) for channel in channels)
            return lane + 1, [total + value for total, value in zip(sums, values, strict=True)]

        # In float32, the sum of thousands of samples would lose the last ones' digits.
        state = self.first, [mi.Float64(0) for _ in channels]
        # All runs of lanes in one kernel.
        _, sums = dr.while_loop(state, lambda lane, sums: lane < end, add, mode="symbolic")
        return [mi.Float(total) for total in sums]


@dataclass(frozen=True)
class Batch:
    """Samples that are traced at once, of N film positions in a camera's view."""

    camera: Camera
    positions: FilmPositions
    spp: int | Counts  # samples of each position, one number for all or N
    offset: mi.UInt32  # samples before these, of width 1 or N
    pattern: int  # seed of the sample positions

    @staticmethod
    def of(
        camera: Camera, positions: FilmPositions, spp: SampleCounts, offset: Offset, pattern: int
    ) -> Batch:
        """A batch by numbers of samples as callers have them, in Python, NumPy or Dr.Jit."""
        if isinstance(offset, np.ndarray):
            offset = mi.UInt32(offset.astype(np.uint32))
        offset = constant(mi.UInt32, offset) if isinstance(offset, int) else mi.UInt32(offset)
        if not isinstance(spp, Counts):
            each = np.asarray(spp)
            sizes = int(each.sum()), int(each.max(initial=0))
            spp = Counts(mi.UInt32(each.astype(np.uint32)), *sizes) if each.ndim else sizes[0]
        return Batch(camera, positions, spp, offset, pattern)

    def parts(self, most: int) -> Iterator[Batch]:
        """The same samples in batches of up to `most` positions."""
        count = self.positions.count
        if count <= most:
            yield self
            return
        for start in range(0, count, most):
            index = dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, min(most, count - start))
            spp, offset = self.spp, self.offset
            if isinstance(spp, Counts):
                spp = Counts.of(dr.gather(mi.UInt32, mi.UInt32(spp.each), index), spp.most)
            if dr.width(offset) > 1:
                offset = dr.gather(mi.UInt32, offset, index)
            yield replace(self, positions=self.positions.taken(index), spp=spp, offset=offset)

    def passes(self, most_lanes: int) -> Iterator[Batch]:
        """The same samples in batches of about so many lanes that have some of each position."""
        spp = self.spp
        most, lanes = (spp.most, spp.total) if isinstance(spp, Counts) else (spp, self.positions.count * spp)
        passes = max(1, min(most, -(-lanes // most_lanes)))
        if passes == 1:
            yield self
            return
        done: Any = 0
        for number in range(passes):
            # Shares as even as whole numbers can be; in the first pass, every position has a sample.
            if isinstance(self.spp, int):
                share: Any = (self.spp * (number + 1) + passes - 1) // passes - done
                yield replace(self, spp=share, offset=self.offset + done)
            else:
                each = mi.UInt64(self.spp.each)
                share = mi.UInt32((each * (number + 1) + passes - 1) // passes) - done
                yield replace(self, spp=Counts.of(share, -(-most // passes) + 1), offset=self.offset + done)
            done = done + share

    @cached_property
    def lanes(self) -> Lanes:
        """The lanes that trace these samples."""
        return Lanes.of(self.positions.count, self.spp)

    @cached_property
    def sequences(self) -> Sequences:
        """Where the samples of these lanes come from."""
        return self.lanes.sequences(self.positions, self.offset, mixed_seeds(self.pattern))

    def rays(self, *others: object) -> tuple[Any, ...]:
        """Film coordinates x and y, mask and camera of all lanes; in one kernel with others."""
        x, y = self.lanes.sample_positions(self.positions, self.sequences)
        active = self.lanes.active
        dr.eval(x, y, active, others)
        return x, y, active, opaque_camera(self.camera)


def joined_channels(parts: list[list[Any]]) -> list[Any]:
    """Channels of all positions from those of parts."""
    if len(parts) == 1:
        return parts[0]
    channels = [dr.concat(of_parts) for of_parts in zip(*parts, strict=True)]
    dr.eval(channels)
    return channels


def random_numbers(state: mi.UInt32, lanes: int) -> mi.Sampler:
    """Independent random numbers of some lanes, of a state of width 1."""
    sampler: mi.Sampler = mi.load_dict({"type": "independent"})
    sampler.seed(state, lanes)
    return sampler


def mixed_seeds(entropy: int | list[int]) -> mi.UInt32:
    """mi.UInt32 of width 1, opaque: 32 bits in which neighbouring seeds have nothing in common."""
    return uploaded(mi.UInt32, np.random.SeedSequence(entropy).generate_state(1))


def fractional_counts(spp: float, positions: int, seed: int) -> int | NDArray[np.int64]:
    """Whole numbers of samples (N,) with mean `spp`, shuffled; `spp` itself if it is whole."""
    whole = math.floor(spp)
    if spp == whole:
        return whole
    more = round((spp - whole) * positions)
    counts = np.full(positions, whole, dtype=np.int64)
    counts[np.random.default_rng(seed).permutation(positions)[:more]] += 1
    return counts
