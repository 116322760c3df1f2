"""Film positions, where rays start on the film, and a camera's rays through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import constant, uploaded
from compose.camera.camera import Camera


@dataclass(frozen=True)
class FilmPositions:
    """N positions on the film, each a box over which samples are averaged.

    x and y are (N,) Dr.Jit floats, the upper left corner of each box; a pixel's corner is its column and row.
    Sizes are in pixels, one for all or (N,) Dr.Jit floats.
    """

    x: Any
    y: Any
    width: Any = 1.0
    height: Any = 1.0

    @property
    def count(self) -> int:
        """N, the number of positions."""
        return dr.width(self.x)

    def part(self, start: int, stop: int) -> FilmPositions:
        """Those from the start-th up to the stop-th."""
        index = dr.opaque(mi.UInt32, start) + dr.arange(mi.UInt32, stop - start)
        of = lambda values: dr.gather(mi.Float, values, index)  # noqa: E731
        sizes = (of(size) if dr.width(size) > 1 else size for size in (self.width, self.height))
        found = FilmPositions(of(self.x), of(self.y), *sizes)
        dr.eval(found.x, found.y)
        return found


def pixel_positions(indices: Any, width: int) -> FilmPositions:
    """Film positions of pixels of a frame of some width, from their row-major indices (N,), mi.UInt32."""
    # Opaque, like everything that may change from frame to frame: a literal would be compiled in.
    columns = constant(mi.UInt32, width)
    row = indices // columns
    positions = FilmPositions(mi.Float(indices - row * columns), mi.Float(row))
    dr.eval(positions.x, positions.y)
    return positions


def box_positions(left: Any, top: Any, width: Any, height: Any) -> FilmPositions:
    """Film positions of N boxes from (N,) numpy arrays of their corners and sizes in pixels."""
    return FilmPositions(*(mi.Float(values.astype(np.float32)) for values in (left, top, width, height)))


def frame_positions(camera: Camera) -> FilmPositions:
    """Film positions of all H * W pixels of a camera's frame, row by row."""
    return pixel_positions(dr.arange(mi.UInt32, camera.width * camera.height), camera.width)


def interleaved(channels: list[Any]) -> NDArray[np.float32]:
    """(N, 3) array from three (N,) Dr.Jit floats, in one kernel, which is quicker than numpy."""
    values: NDArray[np.float32] = dr.ravel(mi.Point3f(*channels)).numpy()
    return values.reshape(-1, 3)


def opaque_camera(camera: Camera) -> tuple[Any, ...]:
    """A camera as one evaluated Dr.Jit array of vectors: origin, ax, ay and az.

    The ray through film coordinates (x, y) has the direction x ax + y ay + az. A new camera changes the
    vectors' values only, so that frozen functions are not recorded again.
    """
    pose = camera.camera_to_world
    ax, ay = pose[:3, 0] / camera.fx, pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    return (uploaded(mi.Float, np.array([pose[:3, 3], ax, ay, az], dtype=np.float32)),)


def ray_through(camera: tuple[Any, ...], x: Any, y: Any, number: Any = 0) -> Any:
    """Rays of an `opaque_camera` through film coordinates x and y, (N,) Dr.Jit floats.

    Of several cameras, joined end to end, `number` says which one a ray is of.
    """
    values = [dr.gather(mi.Float, camera[0], 12 * number + i) for i in range(12)]
    origin = mi.Point3f(*values[:3])
    ax, ay, az = (mi.Vector3f(*values[i : i + 3]) for i in (3, 6, 9))
    return mi.RayDifferential3f(origin, dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az))))


def clipped(ray: Any, camera: tuple[Any, ...], clips: tuple[float, float]) -> tuple[Any, Any]:
    """Rays of an `opaque_camera` between planes at two depths, and how far from the eye they start, (N,)."""
    ax, ay = (mi.Vector3f(*[dr.gather(mi.Float, camera[0], i + k) for k in range(3)]) for i in (3, 6))
    # Length along a ray per unit of depth.
    length = dr.rcp(dr.abs(dr.dot(ray.d, dr.normalize(dr.cross(ax, ay)))))
    near, far = (length * clip for clip in clips)
    within = mi.RayDifferential3f(ray(near), ray.d)
    within.maxt = far - near
    return within, near
