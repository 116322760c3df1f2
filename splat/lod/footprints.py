"""The part of a forest that a camera sees: projected once, and used again while only the gaze moves.

Only layers that are drawn are brought to a time (Fov-GS, section 3.4: selection comes before deformation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import cached_property
from itertools import accumulate, pairwise, starmap
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen, capacity
from compose.camera.camera import Camera
from splat.lod.layer_images import CONTINUOUS, Lattice
from splat.model.dynamic_light import factors_at, in_light, seen_from_behind
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians, as_rows
from splat.model.points import Bits
from splat.raster.binning import depth_order
from splat.raster.cut import HierarchyCut, Turned, turned_footprints
from splat.raster.differentiable import detached
from splat.raster.projection import (
    PIXEL_FILTER,
    CameraNumbers,
    Footprints,
    Parameters,
    camera_numbers,
    directional_constant,
    footprints,
    may_show,
)
from splat.raster.records import RecordLayout, Records, concatenated_records

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

    # Records of footprints, indices of some from near to far, and how many of those matter.
    Ordered = tuple[Records, UInt, int]


class LayerChanges:
    """The changes of the nodes of a layer, from `first` up to `end`; each is given out once per time."""

    def __init__(self, forest: Forest, first: int, end: int):
        self._own, self._course = forest.nodes.gaussians, None
        self._dynamic = first + torch.nonzero(forest.nodes.semantic[first:end] >= 0)[:, 0]
        if forest.motion is not None and len(self._dynamic):
            instance = forest.nodes.semantic[self._dynamic]
            self._course = forest.motion.course(self._own.select(self._dynamic), instance)
        self.moves = self._course is not None
        light = None if forest.light is None else forest.light.among(first, end)
        self._light = light if light is not None and len(light.nodes) else None
        # Those whose light changes, in usual light.
        lit = torch.zeros(0, dtype=torch.int64) if self._light is None else self._light.nodes
        self._usual = self._own.select(lit)
        self._means, self._rotations = self._own.means, self._own.rotations
        self._moved_to, self._lit_at, self._eye = -1.0, -1.0, b""

    def moved(self, time: float) -> tuple[torch.Tensor, Gaussians] | None:
        """Indices (M,) of nodes in the forest and where they are at a time; None if given out already."""
        if self._course is None or self._moved_to == time:
            return None
        self._moved_to = time
        with torch.no_grad():
            found = self._course(time)
        if self._light is not None and len(self._light.sided):
            self._means = self._own.means.index_copy(1, self._dynamic, found.means)
            self._rotations = self._own.rotations.index_copy(1, self._dynamic, found.rotations)
        return self._dynamic, found

    def lit(self, time: float, camera: Camera) -> tuple[torch.Tensor, Gaussians] | None:
        """Indices (M,) of nodes, and Gaussians (M) with harmonics in the light of a time; None if given out.

        The nodes are at that time already. The camera, in their coordinates, matters to those with two sides.
        """
        light = self._light
        if light is None:
            return None
        eye = camera.position.tobytes() if len(light.sided) else b""
        if (self._lit_at, self._eye) == (time, eye):
            return None
        nodes, factors, shown = light.nodes, factors_at(light.factors, time), self._usual
        if len(light.sided):
            sided = nodes[light.sided]
            rest, now, means = (t[:, sided] for t in (self._own.rotations, self._rotations, self._means))
            position = torch.from_numpy(camera.position.copy()).float()
            behind = seen_from_behind(light.normals, rest, now, means, position)
            other = factors_at(light.behind, time)
            factors[:, light.sided] = torch.where(behind, other, factors[:, light.sided])
        if self._lit_at == time:
            # Another eye may see another side; all else is as it was.
            nodes, factors = nodes[light.sided], factors[:, light.sided]
            shown = shown.select(light.sided)
        self._lit_at, self._eye = time, eye
        return nodes, in_light(shown, torch.arange(len(nodes)), factors)


# One float is spare.
_FOOTPRINT = RecordLayout((8, 4), (), **{field.name: 1 for field in fields(Footprints)})
# Floats per load of a node's parameters.
_NODE_LOAD = 8


class ForestFootprints:
    """Footprints of a forest's layers, cached for the latest camera."""

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays, self._place = arrays, forest.place
        self._blending = forest.nodes.gaussians.blending
        self._nodes, self._time = _NodeTable(arrays, forest.nodes.gaussians), 0.0
        self._changes = [LayerChanges(forest, *ends) for ends in forest.ranges]
        self._bounds = [
            _LayerBounds(arrays, forest.nodes.gaussians, *ends, changes.moves)
            for ends, changes in zip(forest.ranges, self._changes, strict=True)
        ]
        self._forest, self._levels = forest, b""
        self._key: tuple[bytes, float] | None = None
        self._layers: dict[int, Ordered | None] = {}
        # The records of all cached layers, as they were asked for last, and where each layer lies among them.
        self.records: Records | None = None
        self._ranges: dict[int, range] = {}

    def set_time(self, time: float) -> None:
        """Shows the nodes as they are at a time from 0 to 1."""
        if time != self._time:
            self._time, self._key = time, None

    def layers(
        self, camera: Camera, blur: float, layers: Sequence[int], levels: Lattice | None = None
    ) -> list[range]:
        """Where the nodes of some layers that may show in a camera's frame lie among all footprints.

        Each layer's lie together, from near to far. `blur` is the widest filter that will be used, as a
        multiple of the filter at the pixel grid; `levels` are those of the layer CONTINUOUS, if it is asked
        for (`splat.raster.cut`).
        """
        if self._key is None or self._key[0] != camera.key or self._key[1] < blur:
            self._layers.clear()
            # Rounded up, since the filter's width changes with the gaze.
            self._key = camera.key, 2.0 ** np.ceil(np.log2(blur))
        if levels is not None and levels.tobytes() != self._levels:
            self._levels = levels.tobytes()
            self._layers.pop(CONTINUOUS, None)
        # A layer at two rates is two images of the same nodes.
        new = [n for n in dict.fromkeys(layers) if n not in self._layers]
        if new:
            own = self._place.camera(camera)
            for n in new:
                if n == CONTINUOUS and levels is not None:
                    self._layers[n] = self._in_cut(own, levels, self._key[1])
                else:
                    self._layers[n] = self._visible(own, n, self._key[1])
            parts = [part for part in self._layers.values() if part is not None]
            self.records = concatenated_records(parts) if parts else None
            counts = (0 if part is None else part[2] for part in self._layers.values())
            ranges = starmap(range, pairwise(accumulate(counts, initial=0)))
            self._ranges = dict(zip(self._layers, ranges, strict=True))
        return [self._ranges[n] for n in layers]

    @cached_property
    def _cut(self) -> tuple[HierarchyCut, _NodeTable]:
        """The nodes of the forest's hierarchy."""
        nodes = self._forest.hierarchy_nodes
        return HierarchyCut(self.arrays, nodes), _NodeTable(self.arrays, nodes.gaussians)

    def least_factor(self, camera: Camera, levels: Lattice, most: int) -> float:
        """What levels are to be multiplied by, 1 or more, for at most so many nodes to be drawn."""
        return self._cut[0].least_factor(self._place.camera(camera), levels, most)

    def differences(
        self, camera: Camera, levels: Lattice, visibility: Float, weights: Lattice
    ) -> NDArray[np.float64]:
        """Sums of visible differences, at each step of the levels' factor, as `HierarchyCut.differences`."""
        return self._cut[0].differences(self._place.camera(camera), levels, visibility, weights)

    def hold_cut(self, drawn: Bits) -> None:
        """Draws no other nodes of the hierarchy than these (N + M,), whatever levels ask for."""
        self._cut[0].hold(drawn)
        self._layers.pop(CONTINUOUS, None)

    def _visible(self, camera: Camera, layer: int, blur: float) -> Ordered | None:
        """The nodes of a layer, at the time that is shown, in the light that a camera sees."""
        changes = self._changes[layer - 1]
        if (moved := changes.moved(self._time)) is not None:
            self._nodes.move(*moved)
            self._bounds[layer - 1].move(*moved)
        if (lit := changes.lit(self._time, camera)) is not None:
            self._nodes.light(*lit)
        bounds, view = self._bounds[layer - 1], camera_numbers(self.arrays, camera, self._blending)
        if not dr.width(bounds.size):
            return None
        shown = may_show(bounds.means, bounds.size, view, PIXEL_FILTER * blur**2)
        index = self.arrays.plain.UInt(dr.compress(shown))
        return self._ordered(self._nodes, index + bounds.first if dr.width(index) else index, None, camera)

    def _in_cut(self, camera: Camera, levels: Lattice, blur: float) -> Ordered | None:
        selection, table = self._cut
        index, turned = selection.nodes(camera, levels, blur)
        return self._ordered(table, index, turned, camera)

    def _ordered(
        self, table: _NodeTable, index: UInt, turned: Turned | None, camera: Camera
    ) -> Ordered | None:
        count = dr.width(index)
        if not count:
            return None
        records, depth = table.footprints(index, camera, turned)
        known = dr.arange(self.arrays.plain.UInt, dr.width(depth)) < self.arrays.constant(count)
        return records, depth_order(self.arrays, depth, known), count


class _LayerBounds:
    """Where the N nodes of one layer are and how large: enough to tell which ones may show."""

    def __init__(self, arrays: Arrays, gaussians: Gaussians, first: int, end: int, moves: bool):
        self._arrays, self._first = arrays, first
        self.first = arrays.constant(first)
        # Three rows (N,), shared with the forest, which is at rest.
        means = gaussians.means.clone() if moves else gaussians.means
        self.means = [detached(arrays, row) for row in means[:, first:end]]
        self.size = detached(arrays, gaussians.part(first, end).longest)

    def move(self, nodes: torch.Tensor, gaussians: Gaussians) -> None:
        """Moves some nodes of the layer, by their indices (M,) in the forest, to where Gaussians (M) are."""
        index = self._arrays.plain.UInt((nodes - self._first).numpy())
        moved = [*gaussians.means, gaussians.longest]
        for row, values in zip([*self.means, self.size], moved, strict=True):
            dr.scatter(row, detached(self._arrays, values), index, mode=dr.ReduceMode.Permute)


class _NodeTable:
    """All parameters of a node side by side, since nodes are gathered from all over the forest."""

    def __init__(self, arrays: Arrays, gaussians: Gaussians):
        self._arrays, self._blending = arrays, gaussians.blending
        # 2, 1, 2, 5 floats are spare for spherical harmonics of degree 0, 1, 2, 3.
        self._records = _uploaded(arrays, **dict(gaussians.tensors()))
        # Harmonics above the constant one, of the nodes that have them.
        self._directional, further = None, gaussians.directional
        if further is not None and further.sh.numel():
            self._directional, self._slot_of = _uploaded(arrays, sh=further.sh), further.slots(len(gaussians))
            self._slots = arrays.plain.Int(self._slot_of.int().numpy())

    def move(self, nodes: torch.Tensor, gaussians: Gaussians) -> None:
        """Gives some nodes (M,) of the forest place, orientation and size of Gaussians (M)."""
        shape = {"means": gaussians.means, "rotations": gaussians.rotations}
        _write(self._records, nodes, **shape, log_scales=gaussians.log_scales)

    def light(self, nodes: torch.Tensor, gaussians: Gaussians) -> None:
        """Gives some nodes (M,) of the forest the spherical harmonics of Gaussians (M)."""
        _write(self._records, nodes, sh=gaussians.sh)
        further = gaussians.directional
        if self._directional is not None and further is not None and len(further):
            _write(self._directional, self._slot_of[nodes[further.index]], sh=further.sh)

    def footprints(self, index: UInt, camera: Camera, turned: Turned | None) -> tuple[Records, Float]:
        """Footprints and depths of the nodes at an index (M,); behind them any, up to a capacity.

        Nodes may have turned into others.
        """
        arrays, count, shown = self._arrays, dr.width(index), []
        for own in (index,) if turned is None else (index, turned.parent):
            shown.append((own, self._added(own, camera)))
        # Dr.Jit walks through dataclasses by their annotations, which do not exist at run time.
        dr.eval(shown, [] if turned is None else [turned.share, turned.heir])
        view = camera_numbers(arrays, camera, self._blending), capacity(count)
        return _footprints(arrays, self._records, shown, turned, arrays.constant(count), *view)

    def _added(self, index: UInt, camera: Camera) -> list[Float] | None:
        """Three channels (M,), of nodes at an index (M,), to be added to their constant harmonic, if any.

        Only nodes that have other harmonics are computed; they lie together in vectors.
        """
        if self._directional is None:
            return None
        Float, UInt = self._arrays.plain.Float, self._arrays.plain.UInt
        added = [dr.zeros(Float, dr.width(index)) for _ in range(3)]
        slot = dr.gather(self._arrays.plain.Int, self._slots, index)
        some = UInt(dr.compress(slot >= 0))
        if dr.width(some):
            sh = _harmonics(self._directional.at(UInt(dr.gather(type(slot), slot, some))).sh)
            means = self._records.at(dr.gather(UInt, index, some)).means
            found = directional_constant(self._arrays, sh, means, camera)
            for target, value in zip(added, found, strict=True):
                dr.scatter(target, value, some, mode=dr.ReduceMode.Permute)
        return added


def _harmonics(rows: list[Float]) -> list[list[Float]]:
    """The three channels of each harmonic."""
    return [rows[k : k + 3] for k in range(0, len(rows), 3)]


def footprints_of_nodes(
    arrays: Arrays,
    nodes: Records,
    shown: list[tuple[UInt, list[Float] | None]],
    turned: Turned | None,
    count: UInt,
    view: CameraNumbers,
    size: int,
) -> tuple[Records, Float]:
    """`size` footprints and their depths, of which the first `count` are those of some nodes.

    Args:
        shown: indices (M,) of the nodes, and of those that they turn into, if they do; with each three
            channels (M,), to be added to their constant harmonics if they have no others.
        turned: how far they have (M,); None if they do not.
    """
    lane = dr.arange(arrays.plain.UInt, size)
    known = lane < count

    def projected(index: UInt, added: list[Float] | None) -> Footprints:
        node = nodes.at(dr.gather(arrays.plain.UInt, index, lane, known))
        sh = _harmonics(node.sh)
        if added is not None:
            more = (dr.gather(type(channel), channel, lane, known) for channel in added)
            sh = [[own + further for own, further in zip(sh[0], more, strict=True)]]
        shape = node.means, node.log_scales, node.rotations, node.opacity_logits
        return footprints(Parameters(*shape, sh), view)

    raw = projected(*shown[0])
    if turned is not None:
        raw = turned_footprints(raw, projected(*shown[1]), turned.at(lane, known))
    return _FOOTPRINT.pack(arrays, **vars(raw)), raw.depth


_footprints = Frozen(footprints_of_nodes)


def _uploaded(arrays: Arrays, **tensors: torch.Tensor) -> Records:
    """Records of tensors (..., N), on the device."""
    rows = {name: as_rows(tensor).numpy() for name, tensor in tensors.items()}
    widths = {name: len(values) for name, values in rows.items()}
    layout = RecordLayout([_NODE_LOAD] * -(-sum(widths.values()) // _NODE_LOAD), (), **widths)
    return layout.upload(arrays, **rows)


def _write(records: Records, nodes: torch.Tensor, **tensors: torch.Tensor) -> None:
    """Overwrites numbers of nodes, by their indices (M,), with tensors (..., M)."""
    values = {name: [detached(records.arrays, row) for row in as_rows(t)] for name, t in tensors.items()}
    records.write(records.arrays.plain.UInt(nodes.numpy()), **values)
