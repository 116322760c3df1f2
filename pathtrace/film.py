"""Film positions, the rays through them, and the lanes that trace several samples of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from compose.view import Camera

# Lanes are padded to a multiple of this with masked ones: a frozen function records again when the
# divisibility of its width changes, and masked lanes at the end cost next to nothing.
_LANE_MULTIPLE = 4096
# Logarithm of the number of places in a box before its sequence begins anew, shifted otherwise.
_PLACES = 12


@dataclass(frozen=True)
class FilmPositions:
    """Places on the film to trace, each a box filter.

    Attributes:
        x, y: (N,) Dr.Jit floats, upper left corner of each box; a pixel's corner is its column and row.
        width, height: of the boxes in pixels, one for all or (N,) Dr.Jit floats.
    """

    x: Any
    y: Any
    width: Any = 1.0
    height: Any = 1.0

    @property
    def count(self) -> int:
        return dr.width(self.x)


def pixel_positions(indices: Any, width: int) -> FilmPositions:
    """Film positions of pixels given by their row-major index, a (N,) Dr.Jit unsigned integer array."""
    # Opaque, like all that may be another number in the next frame: a literal would be compiled in.
    columns = dr.opaque(mi.UInt32, width)
    row = indices // columns
    positions = FilmPositions(mi.Float(indices - row * columns), mi.Float(row))
    dr.eval(positions.x, positions.y)
    return positions


def box_positions(left: Any, top: Any, width: Any, height: Any) -> FilmPositions:
    """Film positions of boxes given by (N,) numpy arrays of their edges and sizes in pixels."""
    return FilmPositions(*(mi.Float(values.astype(np.float32)) for values in (left, top, width, height)))


def frame_positions(camera: Camera) -> FilmPositions:
    """Film positions of all pixels, row by row."""
    return pixel_positions(dr.arange(mi.UInt32, camera.width * camera.height), camera.width)


def interleaved(channels: list[Any]) -> NDArray[np.float32]:
    """(N, 3) of three (N,) Dr.Jit floats; one kernel, which is quicker than numpy."""
    values: NDArray[np.float32] = dr.ravel(mi.Point3f(*channels)).numpy()
    return values.reshape(-1, 3)


def opaque_camera(camera: Camera) -> tuple[Any, ...]:
    """Origin and the three vectors that turn film coordinates into a ray: d ~ x ax + y ay + az."""
    pose = camera.camera_to_world
    ax = pose[:3, 0] / camera.fx
    ay = pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    origin, *axes = (vector.tolist() for vector in (pose[:3, 3], ax, ay, az))
    vectors = mi.Point3f(*origin), *(mi.Vector3f(*axis) for axis in axes)
    dr.make_opaque(vectors)
    return vectors


def ray_through(camera: tuple[Any, ...], x: Any, y: Any) -> Any:
    """Ray of an `opaque_camera` through film coordinates."""
    origin, ax, ay, az = camera
    return mi.RayDifferential3f(origin, dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az))))


@cache
def _sobol() -> NDArray[np.uint32]:
    """(2, 2 ** _PLACES) the binary digits of Sobol's points."""
    points = qmc.Sobol(2, scramble=False, bits=32).random_base2(_PLACES)
    return np.ascontiguousarray((points.T * 2.0**32).astype(np.uint32))


@dataclass(frozen=True)
class Lanes:
    """Which lane traces which sample of which position; the samples of a position lie side by side.

    Attributes:
        count: lanes in use; the others pad.
        active: which those are.
        index, step: position and number of the sample in it, of each lane.
        first: (N,) lane of each position's first sample.
        spp: samples per position.
    """

    count: int
    active: Any
    index: Any
    step: Any
    first: Any
    spp: int | NDArray[np.int64]

    @staticmethod
    def of(positions: int, spp: int | NDArray[np.int64]) -> Lanes:
        """Lanes for so many samples of each position."""
        count = positions * spp if isinstance(spp, int) else int(spp.sum())
        padded = -(-count // _LANE_MULTIPLE) * _LANE_MULTIPLE
        lane = dr.arange(mi.UInt32, padded)
        active = lane < dr.opaque(mi.UInt32, count)
        if isinstance(spp, int):
            index = lane // spp
            first = dr.arange(mi.UInt32, positions) * spp
            return Lanes(count, active, index, lane - index * spp, first, spp)
        first = mi.UInt32(np.cumsum(spp) - spp)
        index = mi.UInt32(np.pad(np.repeat(np.arange(positions), spp), (0, padded - count)))
        step = lane - dr.gather(mi.UInt32, first, index, active)
        return Lanes(count, active, index, step, first, spp)

    def places(self, positions: FilmPositions, taken: Any, pattern: Any) -> tuple[Any, Any]:
        """Film coordinates of each lane.

        Each box has a Sobol sequence of its own, its digits flipped at random (Kollig and Keller 2002):
        unbiased as independent places are, but edges and textures, and with them the guides, have far less
        noise, and later samples go where earlier ones left gaps.

        Args:
            positions: of all samples.
            taken: how many places of its sequence each position has used before; one for all, or (N,).
            pattern: another one, other shifts.
        """
        gathered = lambda values: dr.gather(type(values), values, self.index, self.active)  # noqa: E731
        corner = [gathered(positions.x), gathered(positions.y)]
        if dr.width(taken) > 1:
            taken = gathered(taken)
        bits = [dr.reinterpret_array(mi.UInt32, value) for value in corner]
        number = self.step + taken
        flips = mi.sample_tea_32(bits[0], bits[1] + pattern + (number >> _PLACES))
        number &= (1 << _PLACES) - 1
        unit = [
            mi.Float((dr.gather(mi.UInt32, digits, number) ^ flip) >> 8) * 2**-24
            for digits, flip in zip(map(mi.UInt32, _sobol()), flips, strict=True)
        ]
        sizes = (
            gathered(side) if dr.width(side) > 1 else side for side in (positions.width, positions.height)
        )
        x, y = (at + size * offset for at, size, offset in zip(corner, sizes, unit, strict=True))
        return x, y

    def added_up(self, channel: Any) -> Any:
        """(N,) sums over each position's samples."""
        channel = dr.gather(mi.Float, channel, dr.arange(mi.UInt32, self.count))
        if isinstance(self.spp, int):
            return channel if self.spp == 1 else dr.block_sum(channel, self.spp)
        # A pass may have no sample for a position.
        before = np.concatenate([[0.0], np.cumsum(channel.numpy(), dtype=np.float64)])
        first = self.first.numpy()
        return mi.Float(before[first + self.spp] - before[first])
