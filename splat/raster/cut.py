"""Continuous levels of detail: the nodes of a hierarchy that are neither too large nor needlessly small.

A level is the standard deviation that nodes may have, in pixels as at the frame's centre; it varies over the
frame. A node is drawn if its parent is larger than the level there and it is not itself, all in one pass over
the nodes, together with culling (perceptually guided 3D Gaussian splatting, NYU-ICL, section 3.1). Before two
children disappear, the larger one turns into their parent and the other one fades, so that nothing pops.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.frozen import Frozen
from compose.camera.camera import Camera
from splat.model.cuts import Bits
from splat.model.hierarchy import HierarchyNodes
from splat.raster.projection import (
    NEAR,
    PIXEL_FILTER,
    CameraNumbers,
    Footprints,
    camera_numbers,
    distance,
    view_position,
    within_frame,
)
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import between_corners

Lattice = NDArray[np.float32]
# A node and its parent: centres, standard deviations along the longest axes, and how far from their centres
# those of what is below them lie. Six floats are spare.
_BOUNDS = RecordLayout((8, 8), (), mean=3, size=1, radius=1, parent_mean=3, parent_size=1, parent_radius=1)
# Size of what lies above a root, larger than any level.
_ENDLESS = 1e30
# Share of the way from the level at which a node appears to that at which it disappears, on a logarithmic
# scale, over which it turns into its parent. Until then it is drawn as it is.
_FADE = 0.3
# Steps per octave in which levels are raised to draw fewer nodes, and by how many octaves at most.
_STEPS, _MOST_OCTAVES = 32, 10


class HierarchyCut:
    """Finds the nodes of a hierarchy that levels ask for.

    Nodes that are larger than the level are drawn where there are no finer ones.
    """

    def __init__(self, arrays: Arrays, nodes: HierarchyNodes):
        self._arrays, self._blending, self._count = arrays, nodes.gaussians.blending, len(nodes.size)
        self._leaves = arrays.constant(nodes.leaves)
        means, above = nodes.gaussians.means.numpy(), np.maximum(nodes.parent, 0)
        parent_size = np.where(nodes.parent < 0, np.float32(_ENDLESS), nodes.size[above])
        own = {"mean": means, "size": nodes.size, "radius": nodes.radius}
        parents = {"parent_mean": means[:, above], "parent_radius": nodes.radius[above]}
        self._bounds = _BOUNDS.upload(arrays, **own, **parents, parent_size=parent_size)
        # Roots turn into nothing, so any parent will do.
        self._parent = uploaded(arrays.plain.UInt, above.astype(np.uint32))
        self._is_heir = uploaded(arrays.plain.Float, nodes.is_heir.astype(np.float32))
        self._sibling = nodes.siblings()
        self._held: Any = None

    def hold(self, drawn: Bits) -> None:
        """Draws no other nodes from now on than these (N + M,), whatever levels ask for."""
        # Where a sibling is split, what is below it would not turn into their parent along with a node.
        state = drawn.astype(np.uint32) + (drawn & drawn[self._sibling])
        self._held = uploaded(self._arrays.plain.UInt, state)

    def nodes(self, camera: Camera, levels: Lattice, blur: float) -> tuple[Any, Turned]:
        """Indices UInt (K,) of the nodes to draw, and what they turn into.

        Args:
            camera: in the coordinates of the nodes.
            levels: (rows + 1, columns + 1) over 0, at the corners of cells of TILE pixels.
            blur: the widest filter that will be used, as a multiple of the filter at the pixel grid.
        """
        arrays, index = self._arrays, dr.zeros(self._arrays.plain.UInt, 0)
        if self._count:
            view = self._view(camera, levels, blur)
            found = _drawn(arrays, *view) if self._held is None else _kept(arrays, self._held, *view)
            drawn, turned = found
            index = dr.compress(drawn)
        if not dr.width(index):
            return index, Turned(index, *(dr.zeros(arrays.plain.Float, 0) for _ in range(2)))
        parts = (dr.gather(type(part), part, index) for part in (self._parent, turned, self._is_heir))
        return index, Turned(*parts)

    def least_factor(self, camera: Camera, levels: Lattice, most: int) -> float:
        """What levels are to be multiplied by, 1 or more, for at most so many nodes to be drawn.

        Arguments as of `nodes`; a pixel's filter is taken for granted.
        """
        if not self._count:
            return 1.0
        counts = np.cumsum(_changes(self._arrays, *self._view(camera, levels, blur=1.0)).numpy())
        enough = np.flatnonzero(counts <= most)
        step = float(enough[0] if len(enough) else len(counts) - 1)
        if len(enough) and step:
            # Between two steps, so that the factor does not jump while the gaze moves.
            more, fewer = counts[int(step) - 1], counts[int(step)]
            step -= float(most - fewer) / float(more - fewer)
        return float(2 ** (step / _STEPS))

    def _view(self, camera: Camera, levels: Lattice, blur: float) -> tuple[Any, ...]:
        """What kernels read of the nodes, a camera and levels."""
        arrays, Float = self._arrays, self._arrays.plain.Float
        numbers = camera_numbers(arrays, camera, self._blending)
        low_pass = Float(PIXEL_FILTER * blur**2)
        dr.make_opaque(low_pass)
        table = uploaded(Float, np.ascontiguousarray(levels, dtype=np.float32))
        lattice = LevelTable(table, *map(arrays.constant, levels.shape))
        return self._bounds, self._count, self._leaves, numbers, low_pass, lattice


@dataclass(frozen=True)
class Turned:
    """How far nodes (K,) have turned into their parents."""

    parent: Any  # UInt, their parents' numbers
    share: Any  # Float, from 0 to 1
    heir: Any  # Float, 1 for those that become their parents, 0 for those that fade

    def at(self, index: Any, active: Any) -> Turned:
        """Those at an index (L,), 0 where it is not active."""
        return Turned(*(dr.gather(type(part), part, index, active) for part in vars(self).values()))


@dataclass(frozen=True)
class LevelTable:
    """Levels over a frame, on the device."""

    values: Any  # Float, row by row
    rows: Any  # UInts of width 1
    columns: Any

    def octaves(self, arrays: Arrays, x: Any, y: Any) -> Any:
        """Binary logarithms of the levels at positions in pixels, constant beyond the frame."""
        at = lambda corner: dr.gather(arrays.plain.Float, self.values, corner)  # noqa: E731
        return dr.log2(between_corners(arrays, at, 0, self.rows, self.columns, x, y))


def octaves_too_large(
    arrays: Arrays,
    bounds: Records,
    count: int,
    leaves: Any,
    view: CameraNumbers,
    low_pass: Any,
    levels: LevelTable,
) -> tuple[Any, Any, Any, Any]:
    """By how many octaves `count` nodes, and their parents, exceed the levels where they are.

    Sizes are those seen at the nearest point of spheres that hold all that is below a node: so a parent is
    never smaller than its children, and no node is drawn together with one below it while levels are alike.
    A leaf never exceeds them, and spheres around the eye do by any number. Also returns whether nodes, and
    whether they as large as their parents, reach into the frame.
    """
    node = dr.arange(arrays.plain.UInt, count)
    bound = bounds.at(node)
    focal = dr.maximum(*view.focal)

    def excess(mean: list[Any], position: tuple[Any, Any, Any, Any], size: Any, radius: Any) -> Any:
        seen, x, y, _ = position
        ahead = distance(mean, view) - radius
        found = dr.log2(size * focal) - dr.log2(dr.maximum(ahead, NEAR)) - levels.octaves(arrays, x, y)
        return dr.select(seen & (ahead > NEAR), found, np.inf)

    own = view_position(bound.mean, view)
    below = excess(bound.mean, own, bound.size, bound.radius)
    below = dr.select(node < leaves, dr.minimum(below, 0), below)
    parent = view_position(bound.parent_mean, view)
    above = excess(bound.parent_mean, parent, bound.parent_size, bound.parent_radius)
    reach = [within_frame(own, size, view, low_pass) for size in (bound.size, bound.parent_size)]
    return below, above, *reach


def drawn_nodes(arrays: Arrays, *parts: Any) -> tuple[Any, Any]:
    """Mask of nodes that are drawn, and how far they have turned into their parents, from 0 to 1.

    Arguments as of `octaves_too_large`.
    """
    below, above, shows, parent_shows = octaves_too_large(arrays, *parts)
    passed = dr.maximum(-below, 0)
    way = dr.select(above < np.inf, passed / (passed + above), 0)
    turned = dr.clip((way - (1 - _FADE)) * (1 / _FADE), 0, 1)
    drawn = (below <= 0) & (above > 0) & dr.select(turned > 0, parent_shows, shows)
    return drawn, dr.select(drawn, turned, 0)


def kept_nodes(arrays: Arrays, held: Any, *parts: Any) -> tuple[Any, Any]:
    """What `drawn_nodes` returns, of nodes that are chosen.

    Args:
        held: UInt for each node, 0 if it is not drawn, 2 if its sibling is as well, which lets both turn.
    """
    below, above, shows, parent_shows = octaves_too_large(arrays, *parts)
    held = dr.gather(arrays.plain.UInt, held, dr.arange(arrays.plain.UInt, dr.width(below)))
    passed, rest = dr.maximum(-below, 0), dr.maximum(above, 0)
    way = dr.select((held == 2) & (above < np.inf) & (passed > 0), passed / (passed + rest), 0)
    turned = dr.clip((way - (1 - _FADE)) * (1 / _FADE), 0, 1)
    drawn = (held > 0) & dr.select(turned > 0, parent_shows, shows)
    return drawn, dr.select(drawn, turned, 0)


def changes_of_count(arrays: Arrays, *parts: Any) -> Any:
    """By how much the number of nodes that are drawn changes at each step of the levels' factor, Int.

    The first step is the factor 1. Arguments as of `octaves_too_large`.
    """
    Int, UInt = arrays.plain.Int, arrays.plain.UInt
    below, above, shows, _ = octaves_too_large(arrays, *parts)
    last = _STEPS * _MOST_OCTAVES
    changes = dr.zeros(Int, last + 1)
    shown = shows & (above > 0) & (below < above)
    for octaves, change in ((below, 1), (above, -1)):
        step = dr.ceil(dr.clip(octaves, 0, _MOST_OCTAVES) * _STEPS)
        dr.scatter_add(changes, Int(change), UInt(step), shown & (octaves <= _MOST_OCTAVES))
    return changes


_drawn, _kept, _changes = (
    Frozen(function, by_size=True) for function in (drawn_nodes, kept_nodes, changes_of_count)
)


def turned_footprints(own: Footprints, parent: Footprints, turned: Turned) -> Footprints:
    """Footprints on their way to their parents'."""
    share, keep = turned.share, 1 - turned.share
    mixed = {name: dr.fma(keep, value, share * getattr(parent, name)) for name, value in vars(own).items()}
    mixed["opacity"] = dr.fma(keep, own.opacity, share * turned.heir * parent.opacity)
    # The determinant of a sum of two covariances, each times a factor.
    crossed = own.xx * parent.yy + parent.xx * own.yy - 2 * own.xy * parent.xy
    determinant = (
        dr.square(keep) * own.conditional * own.yy
        + dr.square(share) * parent.conditional * parent.yy
        + keep * share * dr.maximum(crossed, 0)
    )
    mixed["conditional"] = determinant / mixed["yy"]
    # What has not begun to turn is exactly what it is, also where its parent has no footprint.
    begun = share > 0
    return Footprints(**{name: dr.select(begun, mixed[name], value) for name, value in vars(own).items()})
