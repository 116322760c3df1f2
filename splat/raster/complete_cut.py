"""Complete cuts of a hierarchy for a view: as fine in the frame as levels ask for, and coarser beside it.

What `splat.raster.cut` draws ends at the frame. These cuts go all around the viewer, so that another view, a
moment later, shows no hole.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.frozen import Frozen, capacity
from compose.camera.camera import Camera
from splat.model.cuts import Bits, CutTree
from splat.model.hierarchy import HierarchyNodes
from splat.raster.cut import Lattice, LevelTable
from splat.raster.projection import NEAR, REACH, CameraNumbers, axial, camera_numbers, distance, view_position
from splat.raster.records import RecordLayout, Records

# Three floats are spare.
_BOUNDS = RecordLayout((8,), (), mean=3, size=1, radius=1)
# Around the frame, nodes are as fine as at its border for so many degrees; beyond, they may be an octave
# larger every so many degrees, and by so many octaves at most.
_MARGIN, _DEGREES_PER_OCTAVE, _MOST_OCTAVES = 4.0, 4.0, 6.0
# Octaves below the level at which a node that is split is joined again: else nodes at the level would change
# with every movement.
_HYSTERESIS = 0.1


class CompleteCuts:
    """Finds which inner nodes (M,) are split for a view.

    Attributes:
        tree: how the nodes lie above each other.
    """

    def __init__(self, arrays: Arrays, nodes: HierarchyNodes):
        self.tree = CutTree(nodes.parent, nodes.leaves)
        self._arrays, self._blending = arrays, nodes.gaussians.blending
        inner = slice(nodes.leaves, None)
        means, radius = nodes.gaussians.means.numpy()[:, inner], nodes.radius[inner]
        self._bounds = _BOUNDS.upload(arrays, mean=means, size=nodes.size[inner], radius=radius)

    def split(
        self, camera: Camera, levels: Lattice, most: int | None = None, before: Bits | None = None
    ) -> tuple[Bits, float]:
        """Which inner nodes (M,) are split, with all above them, and the factor of levels, 1 or more.

        Args:
            camera: in the coordinates of the nodes.
            levels: (rows + 1, columns + 1) over 0, standard deviation in pixels that nodes may have, at the
                corners of cells of TILE pixels.
            most: nodes that a cut may have, unless there are more roots; levels are raised by a factor
                if it had more.
            before: what was split for the view before, most of which stays.
        """
        excess = self._excess(camera, levels)
        if before is not None:
            excess = excess + np.float32(_HYSTERESIS) * before
        excess = self.tree.falling(excess)
        limit = np.float32(0)
        # Each node that is split adds one to the cut.
        spare = None if most is None else max(0, most - self.tree.roots)
        if spare is not None and spare < len(excess):
            limit = max(limit, np.partition(excess, -spare - 1)[-spare - 1])
        return excess > limit, float(2**limit)

    def _excess(self, camera: Camera, levels: Lattice) -> NDArray[np.float32]:
        """By how many octaves each inner node is larger than it may be."""
        arrays, Float = self._arrays, self._arrays.plain.Float
        if not self.tree.inner:
            return np.zeros(0, np.float32)
        corners = [(x, y) for x in (0, camera.width) for y in (0, camera.height)]
        tangent = max(
            math.hypot((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy) for x, y in corners
        )
        # Frames have many sizes, recordings few.
        padded = np.zeros(capacity(levels.size), np.float32)
        padded[: levels.size] = levels.ravel()
        table = uploaded(Float, padded)
        lattice = LevelTable(table, *map(arrays.constant, levels.shape))
        cone = Float(math.atan(tangent) + math.radians(_MARGIN))
        dr.make_opaque(cone)
        view = camera_numbers(arrays, camera, self._blending)
        return np.array(_octaves(arrays, self._bounds, self.tree.inner, view, cone, lattice))


def octaves_over(
    arrays: Arrays, bounds: Records, count: int, view: CameraNumbers, cone: Any, levels: LevelTable
) -> Any:
    """By how many octaves `count` nodes are larger than they may be, infinite where that cannot be told.

    Sizes are those at the nearest point of a sphere that holds all that is below a node, and directions those
    of such spheres: neither can be less for a parent than for its children.

    Args:
        cone: angle in radians from the view axis within which nodes are as large as the levels say.
    """
    bound = bounds.at(dr.arange(arrays.plain.UInt, count))
    away, ahead = distance(bound.mean, view), axial(bound.mean, view)
    nearest = away - bound.radius
    half = dr.asin(dr.minimum((bound.radius + REACH * bound.size) / dr.maximum(away, NEAR), 1))
    beside = dr.acos(dr.clip(ahead / dr.maximum(away, NEAR), -1, 1)) - half - cone
    allowed = dr.clip(beside * (math.degrees(1) / _DEGREES_PER_OCTAVE), 0, _MOST_OCTAVES)
    seen, x, y, _ = view_position(bound.mean, view)
    size = dr.log2(bound.size * dr.maximum(*view.focal)) - dr.log2(dr.maximum(nearest, NEAR))
    known = (nearest > NEAR) & (seen | (beside > 0))
    return dr.select(known, size - levels.octaves(arrays, x, y) - allowed, np.inf)


_octaves = Frozen(octaves_over, by_size=True)
