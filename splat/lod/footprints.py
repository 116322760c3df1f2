"""What of a forest shows in the frame of one camera: kept, and used again while only the gaze moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from compose.camera.camera import Camera
from splat.base.arrays import Arrays
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.raster.binning import by_depth
from splat.raster.projection import PIXEL_FILTER, Footprints, Parameters, footprints, view_position

# Standard deviations at which the most opaque Gaussian falls to 1/255.
_REACH = 3.33
# Floats that one load brings.
_LOAD = 8


@dataclass
class LayerFootprints:
    """The nodes of one layer that may show in a frame, from near to far, as Dr.Jit floats.

    Attributes:
        x, y: centre in pixels.
        xx, yy: variances in px^2, not filtered.
        extent: variances beyond which they fall below 1/255.
        records: footprints, side by side: eight numbers and four.
    """

    x: Any
    y: Any
    xx: Any
    yy: Any
    extent: Any
    records: tuple[Any, Any]


class ForestFootprints:
    """The footprints of a forest's layers for the camera that was asked for last.

    Args:
        arrays: the backend's array types.
        forest: its nodes stay on the device.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays = arrays
        self._nodes = _NodeTable(arrays, forest.nodes.gaussians)
        first = np.cumsum([0, *forest.counts])
        self._places = [
            _Places(arrays, forest.nodes.gaussians, int(first[n]), int(first[n + 1]))
            for n in range(len(forest.counts))
        ]
        self._key: tuple[bytes, float] | None = None
        self._layers: dict[int, LayerFootprints | None] = {}
        self._first: dict[int, Any] = {}
        self._table: list[Any] = []

    def layers(self, camera: Camera, blur: float, layers: Sequence[int]) -> list[LayerFootprints | None]:
        """What of some layers may show in a camera's frame, None where nothing does.

        Args:
            camera: the view.
            blur: the widest filter that will be asked for, in units of that at the pixel grid.
            layers: 1 to L.
        """
        if self._key is None or self._key[0] != camera.key or self._key[1] < blur:
            self._layers.clear()
            # With some room to spare: the filter's width changes with the gaze.
            self._key = camera.key, 2.0 ** np.ceil(np.log2(blur))
        new = [n for n in layers if n not in self._layers]
        for n in new:
            self._layers[n] = self._seen(camera, n, self._key[1])
        if new:
            self._join_tables()
        return [self._layers[n] for n in layers]

    def footprints(self, layers: Sequence[int], chosen: Sequence[Any]) -> Footprints:
        """Those of some of the nodes of layers that were asked for, one layer after the other.

        Args:
            layers: 1 to L.
            chosen: indices of the nodes in each of them; in one of them at least there are some.
        """
        some = [i + self._first[n] for n, i in zip(layers, chosen, strict=True) if dr.width(i)]
        index = self.arrays.joined(some)
        values = self.arrays.record(self._table[0], index, _LOAD)
        return Footprints(*values, *self.arrays.record(self._table[1], index, _LOAD // 2)[:3])

    def _join_tables(self) -> None:
        made = {n: layer for n, layer in self._layers.items() if layer is not None}
        starts = np.cumsum([0, *(dr.width(layer.x) for layer in made.values())])
        self._first = {n: self.arrays.number(int(start)) for n, start in zip(made, starts, strict=False)}
        self._table = [
            self.arrays.joined([layer.records[k] for layer in made.values()]) for k in (0, 1) if made
        ]

    def _seen(self, camera: Camera, layer: int, blur: float) -> LayerFootprints | None:
        places, plain = self._places[layer - 1], self.arrays.plain
        seen, x, y, spread = view_position(self.arrays, places.means, camera)
        reach = _REACH * dr.sqrt(dr.square(places.size * spread) + PIXEL_FILTER * blur**2)
        half_width, half_height = (dr.opaque(plain.Float, side / 2) for side in (camera.width, camera.height))
        seen &= (dr.abs(x - half_width) < half_width + reach) & (
            dr.abs(y - half_height) < half_height + reach
        )
        index = dr.compress(seen)
        if not dr.width(index):
            return None
        raw = footprints(self._nodes.parameters(index + places.first), camera)
        rows = list(raw.__dict__.values())
        records = [self.arrays.records(rows[:_LOAD]), self.arrays.records([*rows[_LOAD:], plain.Float(0)])]
        dr.eval(records, raw.depth)
        order = by_depth(self.arrays, raw.depth, plain.Bool(True))
        near_to_far = [
            self.arrays.record(table, order, size)
            for table, size in zip(records, (_LOAD, _LOAD // 2), strict=True)
        ]
        x, y, xx, _, yy, _, opacity, _ = near_to_far[0]
        extent = 2 * dr.log(dr.maximum(opacity * 255, 1))
        ordered = self.arrays.records(near_to_far[0]), self.arrays.records(near_to_far[1])
        dr.eval(x, y, xx, yy, extent, ordered)
        return LayerFootprints(x, y, xx, yy, extent, ordered)


class _Places:
    """Where the nodes of one layer are, and how large: enough to see whether they may show.

    Attributes:
        first: index of the first in the forest.
        means: three rows.
        size: longest axis, as a standard deviation.
    """

    def __init__(self, arrays: Arrays, gaussians: Gaussians, first: int, end: int):
        plain = lambda row: dr.detach(arrays.from_torch(row), preserve_type=False)  # noqa: E731
        self.first = arrays.number(first)
        self.means = [plain(row) for row in gaussians.means[:, first:end]]
        self.size = plain(gaussians.log_scales[:, first:end].max(dim=0).values.exp())


class _NodeTable:
    """All parameters of a node side by side, as nodes are picked from all over the forest."""

    def __init__(self, arrays: Arrays, gaussians: Gaussians):
        self.arrays = arrays
        self._coefficients = gaussians.sh.shape[0]
        rows = [*gaussians.means, *gaussians.log_scales, *gaussians.rotations, gaussians.opacity_logits]
        rows += list(gaussians.sh.reshape(-1, len(gaussians)))
        self._loads = -(-len(rows) // _LOAD)
        table = np.zeros((len(gaussians), self._loads * _LOAD), dtype=np.float32)
        for column, row in enumerate(rows):
            table[:, column] = row.numpy()
        self._table = arrays.plain.Float(table.ravel())

    def parameters(self, index: Any) -> Parameters:
        """Of the nodes at these indices."""
        values: list[Any] = []
        for load in range(self._loads):
            values += self.arrays.record(self._table, index * self._loads + load, _LOAD)
        colours = values[11 : 11 + 3 * self._coefficients]
        sh = [colours[3 * k : 3 * k + 3] for k in range(self._coefficients)]
        return Parameters(values[:3], values[3:6], values[6:10], values[10], sh)
