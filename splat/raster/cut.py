"""Continuous levels of detail: the nodes of a hierarchy that are neither too large nor needlessly small.

A level is the standard deviation that nodes may have, in pixels as at the frame's centre; it varies over the
frame. A node is drawn if its parent is larger than the level there and it is not itself, all in one pass over
the nodes, together with culling (perceptually guided 3D Gaussian splatting, NYU-ICL, section 3.1). Before two
children disappear, the larger one turns into their parent and the other one fades, so that nothing pops.

What is drawn ends at the frame. Complete cuts go all around the viewer, coarser beside the frame, so that
another view, a moment later, shows no hole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.frozen import Frozen, capacity
from compose.camera.camera import Camera
from splat.model.hierarchy import CutTree, HierarchyNodes
from splat.model.points import Bits
from splat.raster.projection import (
    NEAR,
    PIXEL_FILTER,
    REACH,
    CameraNumbers,
    Footprints,
    axial,
    camera_numbers,
    distance,
    view_position,
    within_frame,
)
from splat.raster.records import RecordLayout, Records
from splat.raster.tiles import between_corners

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, Float64, Int, UInt

    from splat.raster.projection import Position

Lattice = NDArray[np.float32]
Number = TypeVar("Number", "Int", "Float64")
# A node and its parent: centres, sizes, standard deviations along the longest axes, and how far from their
# centres those of what is below them lie. Four floats are spare.
_BOUNDS = RecordLayout(
    (8, 8),
    (),
    **{"mean": 3, "size": 1, "extent": 1, "radius": 1},
    **{"parent_mean": 3, "parent_size": 1, "parent_extent": 1, "parent_radius": 1},
)
# Size of what lies above a root, larger than any level.
_ENDLESS = 1e30
# Share of the way from the level at which a node appears to that at which it disappears, on a logarithmic
# scale, over which it turns into its parent. Until then it is drawn as it is.
_FADE = 0.3
# Pixels beyond which an extent counts no more, so that sums stay finite.
_MOST_SEEN = 1e6
# Steps per octave in which levels are raised to draw fewer nodes, and by how many octaves at most.
_STEPS, _MOST_OCTAVES = 32, 10


@dataclass(frozen=True)
class LevelTable:
    """Levels over a frame, on the device."""

    values: Float  # row by row, up to a capacity
    size: tuple[UInt, UInt]  # rows and columns

    @staticmethod
    def of(arrays: Arrays, levels: Lattice) -> LevelTable:
        """Levels from host memory."""
        # Frames have many sizes, recordings few.
        padded = np.zeros(capacity(levels.size), np.float32)
        padded[: levels.size] = levels.ravel()
        rows, columns = map(arrays.constant, levels.shape)
        return LevelTable(uploaded(arrays.plain.Float, padded), (rows, columns))

    def at(self, arrays: Arrays, x: Float, y: Float) -> Float:
        """The levels at positions in pixels, constant beyond the frame."""
        corner = lambda index: dr.gather(arrays.plain.Float, self.values, index)  # noqa: E731
        return between_corners(arrays, corner, 0, self.size, x, y)

    def octaves(self, arrays: Arrays, x: Float, y: Float) -> Float:
        """Their binary logarithms."""
        return dr.log2(self.at(arrays, x, y))


@dataclass(frozen=True)
class NodesInView:
    """Nodes, a camera and levels, as kernels read them."""

    bounds: Records
    count: int
    leaves: UInt
    view: CameraNumbers
    low_pass: Float
    levels: LevelTable


@dataclass(frozen=True)
class Turned:
    """How far nodes (K,) have turned into their parents."""

    parent: UInt  # their parents' numbers
    share: Float  # from 0 to 1
    heir: Float  # 1 for those that become their parents, 0 for those that fade

    def at(self, index: UInt, active: Bool) -> Turned:
        """Those at an index (L,), 0 where it is not active."""
        return Turned(*(dr.gather(type(part), part, index, active) for part in vars(self).values()))


class HierarchyCut:
    """Finds the nodes of a hierarchy that levels ask for.

    Nodes that are larger than the level are drawn where there are no finer ones.
    """

    def __init__(self, arrays: Arrays, nodes: HierarchyNodes):
        self._arrays, self._blending, self._count = arrays, nodes.gaussians.blending, len(nodes.size)
        self._leaves = arrays.constant(nodes.leaves)
        means, above = nodes.gaussians.means.numpy(), np.maximum(nodes.parent, 0)
        parent_size = np.where(nodes.parent < 0, np.float32(_ENDLESS), nodes.size[above])
        own = {"mean": means, "size": nodes.size, "extent": nodes.extent, "radius": nodes.radius}
        parents = {
            "parent_mean": means[:, above],
            "parent_extent": nodes.extent[above],
            "parent_radius": nodes.radius[above],
        }
        self._bounds = _BOUNDS.upload(arrays, **own, **parents, parent_size=parent_size)
        # Roots turn into nothing, so any parent will do.
        self._parent = uploaded(arrays.plain.UInt, above.astype(np.uint32))
        self._is_heir = uploaded(arrays.plain.Float, nodes.is_heir.astype(np.float32))
        self._sibling = nodes.siblings()
        self._held: UInt | None = None

    def hold(self, drawn: Bits) -> None:
        """Draws no other nodes from now on than these (N + M,), whatever levels ask for."""
        # Where a sibling is split, what is below it would not turn into their parent along with a node.
        state = drawn.astype(np.uint32) + (drawn & drawn[self._sibling])
        self._held = uploaded(self._arrays.plain.UInt, state)

    def nodes(self, camera: Camera, levels: Lattice, blur: float) -> tuple[UInt, Turned]:
        """Indices (K,) of the nodes to draw, and what they turn into.

        Args:
            camera: in the coordinates of the nodes.
            levels: (rows + 1, columns + 1) over 0, at the corners of cells of TILE pixels.
            blur: the widest filter that will be used, as a multiple of the filter at the pixel grid.
        """
        arrays, index = self._arrays, dr.zeros(self._arrays.plain.UInt, 0)
        if self._count:
            drawn, turned = _drawn(arrays, self._view(camera, levels, blur), self._held)
            index = arrays.plain.UInt(dr.compress(drawn))
        if not dr.width(index):
            return index, Turned(index, *(dr.zeros(arrays.plain.Float, 0) for _ in range(2)))
        share, heir = (dr.gather(arrays.plain.Float, part, index) for part in (turned, self._is_heir))
        return index, Turned(dr.gather(arrays.plain.UInt, self._parent, index), share, heir)

    def least_factor(self, camera: Camera, levels: Lattice, most: int) -> float:
        """What levels are to be multiplied by, 1 or more, for at most so many nodes to be drawn.

        Arguments as of `nodes`; a pixel's filter is taken for granted.
        """
        if not self._count:
            return 1.0
        counts = np.cumsum(_changes(self._arrays, self._view(camera, levels, blur=1.0)).numpy())
        enough = np.flatnonzero(counts <= most)
        step = float(enough[0] if len(enough) else len(counts) - 1)
        if len(enough) and step:
            # Between two steps, so that the factor does not jump while the gaze moves.
            more, fewer = counts[int(step) - 1], counts[int(step)]
            step -= float(most - fewer) / float(more - fewer)
        return float(2 ** (step / _STEPS))

    def differences(
        self, camera: Camera, levels: Lattice, visibility: Float, weights: Lattice
    ) -> NDArray[np.float64]:
        """Sums of the visible differences of the nodes that are drawn, at each step of the levels' factor.

        Args:
            camera, levels: as of `nodes`.
            visibility: (N + M,) of each node, 0 or more, what it makes visible where its extent is one pixel;
                that grows with the fourth power of its extent.
            weights: (rows + 1, columns + 1) over 0, what that counts at the corners of cells.
        """
        if not self._count:
            return np.zeros(_STEPS * _MOST_OCTAVES + 1)
        table = LevelTable.of(self._arrays, weights)
        changes = _differences(self._arrays, self._view(camera, levels, blur=1.0), visibility, table)
        # Where parents show less than their children do together, higher levels count as no better.
        sums = np.float32(np.cumsum(changes.numpy()))
        return np.maximum.accumulate(sums.astype(np.float64))

    def _view(self, camera: Camera, levels: Lattice, blur: float) -> NodesInView:
        arrays = self._arrays
        view, lattice = camera_numbers(arrays, camera, self._blending), LevelTable.of(arrays, levels)
        low_pass = arrays.plain.Float(PIXEL_FILTER * blur**2)
        dr.make_opaque(low_pass)
        return NodesInView(self._bounds, self._count, self._leaves, view, low_pass, lattice)


def greatest_factor(sums: NDArray[np.float64], most: float) -> float:
    """What levels may be multiplied by, 1 or more, for `HierarchyCut.differences` of at most so much."""
    step = max(1, int(np.searchsorted(sums, most, "right"))) - 1
    between = 0.0
    if step + 1 < len(sums) and sums[step] <= most:
        between = (most - sums[step]) / (sums[step + 1] - sums[step])
    return float(2 ** ((step + between) / _STEPS))


def octaves_too_large(arrays: Arrays, nodes: NodesInView) -> tuple[Float, Float, Bool, Bool]:
    """By how many octaves nodes, and their parents, exceed the levels where they are.

    Sizes are those seen at the nearest point of spheres that hold all that is below a node: so a parent is
    never smaller than its children, and no node is drawn together with one below it while levels are alike.
    A leaf never exceeds them, and spheres around the eye do by any number. Also returns whether nodes, and
    whether they as large as their parents, reach into the frame.
    """
    node, view = dr.arange(arrays.plain.UInt, nodes.count), nodes.view
    bound = nodes.bounds.at(node)
    focal = dr.maximum(*view.focal)

    def excess(mean: list[Float], position: Position, size: Float, radius: Float) -> Float:
        seen, x, y, _ = position
        ahead = distance(mean, view) - radius
        found = dr.log2(size * focal) - dr.log2(dr.maximum(ahead, NEAR)) - nodes.levels.octaves(arrays, x, y)
        return dr.select(seen & (ahead > NEAR), found, np.inf)

    own = view_position(bound.mean, view)
    below = excess(bound.mean, own, bound.size, bound.radius)
    below = dr.select(node < nodes.leaves, dr.minimum(below, 0), below)
    parent = view_position(bound.parent_mean, view)
    above = excess(bound.parent_mean, parent, bound.parent_size, bound.parent_radius)
    shows, parent_shows = (
        within_frame(own, size, view, nodes.low_pass) for size in (bound.extent, bound.parent_extent)
    )
    return below, above, shows, parent_shows


def drawn_nodes(arrays: Arrays, nodes: NodesInView, held: UInt | None) -> tuple[Bool, Float]:
    """Mask of nodes that are drawn, and how far they have turned into their parents, from 0 to 1.

    Args:
        held: for each node that may be drawn, whatever levels ask for, 1, or 2 if its sibling may be as well,
            which lets both turn; 0 for others. None to draw what levels ask for.
    """
    below, above, shows, parent_shows = octaves_too_large(arrays, nodes)
    passed, rest = dr.maximum(-below, 0), dr.maximum(above, 0)
    turns, chosen = (above < np.inf) & (passed > 0), (below <= 0) & (above > 0)
    if held is not None:
        state = dr.gather(arrays.plain.UInt, held, dr.arange(arrays.plain.UInt, nodes.count))
        turns, chosen = turns & (state == 2), state > 0
    way = dr.select(turns, passed / (passed + rest), 0)
    turned = dr.clip((way - (1 - _FADE)) * (1 / _FADE), 0, 1)
    drawn = chosen & dr.select(turned > 0, parent_shows, shows)
    return drawn, dr.select(drawn, turned, 0)


def changes_of_count(arrays: Arrays, nodes: NodesInView) -> Int:
    """By how much the number of nodes that are drawn changes at each step of the levels' factor.

    The first step is the factor 1.
    """
    return _changes_of(arrays, nodes, arrays.plain.Int(1))


def changes_of_difference(
    arrays: Arrays, nodes: NodesInView, visibility: Float, weights: LevelTable
) -> Float64:
    """The same of what `HierarchyCut.differences` sums up."""
    node, view = dr.arange(arrays.plain.UInt, nodes.count), nodes.view
    bound = nodes.bounds.at(node)
    _, x, y, _ = view_position(bound.mean, view)
    ahead = dr.maximum(distance(bound.mean, view) - bound.radius, NEAR)
    seen = dr.minimum(bound.extent * dr.maximum(*view.focal) / ahead, _MOST_SEEN)
    shown = dr.gather(arrays.plain.Float, visibility, node) * weights.at(arrays, x, y)
    # Threads add up in any order, which must not show.
    value = arrays.plain.Float64(shown * dr.square(dr.square(seen)))
    return _changes_of(arrays, nodes, value)


def _changes_of(arrays: Arrays, nodes: NodesInView, value: Number) -> Number:
    """The changes of a sum of values of the nodes that are drawn, one or (N + M,)."""
    below, above, shows, parent_shows = octaves_too_large(arrays, nodes)
    changes = dr.zeros(type(value), _STEPS * _MOST_OCTAVES + 1)
    # From there on, nodes turn into their parents.
    turning = dr.select(above < np.inf, dr.fma(1 - _FADE, above - below, below), above)
    for start, end, visible in ((below, turning, shows), (turning, above, parent_shows)):
        shown = visible & (end > 0) & (start < end)
        for octaves, change in ((start, value), (end, -value)):
            step = dr.ceil(dr.clip(octaves, 0, _MOST_OCTAVES) * _STEPS)
            dr.scatter_add(changes, change, arrays.plain.UInt(step), shown & (octaves <= _MOST_OCTAVES))
    return changes


_drawn, _changes = Frozen(drawn_nodes, by_size=True), Frozen(changes_of_count, by_size=True)
_differences = Frozen(changes_of_difference, by_size=True)


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


# Of an inner node as above. Two floats are spare.
_SPHERES = RecordLayout((8,), (), mean=3, size=1, extent=1, radius=1)
# Around the frame, nodes are as fine as at its border for so many degrees; beyond, they may be an octave
# larger every so many degrees, and by so many octaves at most.
_MARGIN, _DEGREES_PER_OCTAVE, _MOST_BESIDE = 4.0, 4.0, 6.0
# Octaves below the level at which a split node is joined again, or nodes would change with every movement.
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
        bounds = {name: getattr(nodes, name)[inner] for name in ("size", "extent", "radius")}
        self._spheres = _SPHERES.upload(arrays, mean=nodes.gaussians.means.numpy()[:, inner], **bounds)

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
        if not self.tree.inner:
            return np.zeros(0, bool), 1.0
        across = max(abs(x - camera.cx) for x in (0, camera.width)) / camera.fx
        down = max(abs(y - camera.cy) for y in (0, camera.height)) / camera.fy
        cone = self._arrays.plain.Float(math.atan(math.hypot(across, down)) + math.radians(_MARGIN))
        dr.make_opaque(cone)
        view = camera_numbers(self._arrays, camera, self._blending)
        lattice = LevelTable.of(self._arrays, levels)
        excess = np.array(_octaves(self._arrays, self._spheres, self.tree.inner, view, cone, lattice))
        if before is not None:
            excess = excess + np.float32(_HYSTERESIS) * before
        excess = self.tree.falling(excess)
        limit = np.float32(0)
        # Each node that is split adds one to the cut.
        spare = None if most is None else max(0, most - self.tree.roots)
        if spare is not None and spare < len(excess):
            limit = max(limit, np.partition(excess, -spare - 1)[-spare - 1])
        return excess > limit, float(2**limit)


def octaves_over(
    arrays: Arrays, spheres: Records, count: int, view: CameraNumbers, cone: Float, levels: LevelTable
) -> Float:
    """By how many octaves `count` nodes are larger than they may be, infinite where that cannot be told.

    Sizes are those at the nearest point of a sphere that holds all that is below a node, and directions those
    of such spheres: neither can be less for a parent than for its children.

    Args:
        cone: angle in radians from the view axis within which nodes are as large as the levels say.
    """
    sphere = spheres.at(dr.arange(arrays.plain.UInt, count))
    away, ahead = distance(sphere.mean, view), axial(sphere.mean, view)
    nearest = away - sphere.radius
    half = dr.asin(dr.minimum((sphere.radius + REACH * sphere.extent) / dr.maximum(away, NEAR), 1))
    beside = dr.acos(dr.clip(ahead / dr.maximum(away, NEAR), -1, 1)) - half - cone
    allowed = dr.clip(beside * (math.degrees(1) / _DEGREES_PER_OCTAVE), 0, _MOST_BESIDE)
    seen, x, y, _ = view_position(sphere.mean, view)
    size = dr.log2(sphere.size * dr.maximum(*view.focal)) - dr.log2(dr.maximum(nearest, NEAR))
    known = (nearest > NEAR) & (seen | (beside > 0))
    return dr.select(known, size - levels.octaves(arrays, x, y) - allowed, np.inf)


_octaves = Frozen(octaves_over, by_size=True)
