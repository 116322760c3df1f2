"""What a set of views has seen: how finely the best of them showed each point.

One view alone does not tell how far away a point is: it takes a few that agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.camera.camera import Camera

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Relative difference of depths up to which a point is visible: what is not hidden may lie a little deeper
# than what the four rays around it hit.
_TOLERANCE = 0.02
# Views, if there are as many, that must have seen a point at least as finely as it is said to be seen.
_VIEWS = 3
# Floats per view: rows of its world-to-camera transform, then focal lengths and centre in cells of its map,
# and the size of its pixels at depth 1.
_VIEW = 17


class SeenSurfaces:
    """The surfaces that V views see, each view as a small depth map.

    Maps (V, h, w) are depths along the view axis at the centres of cells of each view's frame; where there is
    nothing, beyond all that is asked for. ValueError without a view, or a map of each.
    """

    def __init__(self, arrays: Arrays, cameras: Sequence[Camera], depths: NDArray[np.float32]):
        if not cameras or depths.ndim != 3 or len(depths) != len(cameras) or not depths.size:
            raise ValueError(f"depth maps of shape {depths.shape} for {len(cameras)} views")
        self._arrays, self._views_given = arrays, len(cameras)
        views, rows, columns = depths.shape
        self._sizes = arrays.constant(views), arrays.constant(rows), arrays.constant(columns)
        self._depths = uploaded(arrays.plain.Float, depths.astype(np.float32))
        floats = np.stack([_floats(camera, rows, columns) for camera in cameras])
        self._views = uploaded(arrays.plain.Float, floats)
        dr.eval(self._sizes, self._depths, self._views)

    def finest(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(N,) size in the world of the third-finest pixel that shows each point (N, 3).

        With fewer than three views it is that of the coarsest; inf where too few views show the point.
        """
        plain = self._arrays.plain
        point = [uploaded(plain.Float, points[:, k].astype(np.float32)) for k in range(3)]
        found = _finest(plain, point, self._views, self._depths, self._sizes)
        dr.eval(found)
        return found[min(_VIEWS, self._views_given) - 1].numpy()


def _floats(camera: Camera, rows: int, columns: int) -> NDArray[np.float32]:
    across, down = columns / camera.width, rows / camera.height
    numbers = camera.fx * across, camera.fy * down, camera.cx * across, camera.cy * down, 1 / camera.fy
    return np.concatenate([camera.world_to_camera[:3].ravel(), numbers]).astype(np.float32)


@dr.syntax
def _finest(
    plain: ModuleType, point: list[Float], views: Float, depths: Float, sizes: tuple[UInt, UInt, UInt]
) -> list[Float]:
    """Sizes of the three finest pixels that show points, three (N,) Floats; inf where there are fewer."""
    x, y, z = point
    count, rows, columns = sizes
    best, second, third = (dr.full(plain.Float, dr.inf, dr.width(x)) for _ in range(_VIEWS))
    view = dr.zeros(plain.UInt, dr.width(x))
    while dr.hint(view < count, exclude=[x, y, z, views, depths, count, rows, columns]):
        v = [dr.gather(plain.Float, views, view * _VIEW + k) for k in range(_VIEW)]
        local_x = dr.fma(v[0], x, dr.fma(v[1], y, dr.fma(v[2], z, v[3])))
        local_y = dr.fma(v[4], x, dr.fma(v[5], y, dr.fma(v[6], z, v[7])))
        depth = dr.fma(v[8], x, dr.fma(v[9], y, dr.fma(v[10], z, v[11])))
        column = dr.fma(v[12], local_x / depth, v[14])
        row = dr.fma(v[13], local_y / depth, v[15])
        inside = (depth > 0) & (column >= 0) & (row >= 0)
        inside &= (column < plain.Float(columns)) & (row < plain.Float(rows))
        # The four cells whose centres lie around the point, or the nearest ones within the map.
        left, top = (plain.Int(dr.floor(value - 0.5)) for value in (column, row))
        deepest = plain.Float(0)
        for k in range(4):
            i = plain.UInt(dr.clip(top + k // 2, 0, plain.Int(rows) - 1))
            j = plain.UInt(dr.clip(left + k % 2, 0, plain.Int(columns) - 1))
            there = dr.gather(plain.Float, depths, (view * rows + i) * columns + j, inside)
            deepest = dr.maximum(deepest, there)
        visible = inside & (depth <= deepest * (1 + _TOLERANCE))
        size = dr.select(visible, depth * v[16], dr.inf)
        third = dr.minimum(third, dr.maximum(second, size))
        second = dr.minimum(second, dr.maximum(best, size))
        best = dr.minimum(best, size)
        view += 1
    return [best, second, third]
