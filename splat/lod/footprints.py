"""The part of a forest that a camera sees: projected once, and used again while only the gaze moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.model.light_course import LightCourse, in_light, seen_from_behind
from splat.raster.binning import depth_order
from splat.raster.projection import PIXEL_FILTER, Footprints, Parameters, footprints, may_show
from splat.raster.records import RecordLayout, Records, concatenated_records

# The fields of `Footprints`. One float is spare.
_FOOTPRINT = RecordLayout(
    (8, 4), x=1, y=1, xx=1, xy=1, yy=1, conditional=1, opacity=1, red=1, green=1, blue=1, depth=1
)
# Floats per load of a node's parameters.
_NODE_LOAD = 8


@dataclass
class LayerFootprints:
    """The N nodes of one layer that may show in a frame, from near to far, as Dr.Jit floats.

    Attributes:
        x, y: (N,) centre in pixels.
        xx, yy: (N,) variances in px^2, not filtered.
        extent: (N,) square of the distance, in standard deviations, beyond which alpha is below 1/255.
        records: their footprints.
    """

    x: Any
    y: Any
    xx: Any
    yy: Any
    extent: Any
    records: Records


class ForestFootprints:
    """Footprints of a forest's layers, cached for the latest camera.

    Args:
        arrays: the backend's array types.
        forest: its nodes are copied to the device.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays, self._place = arrays, forest.place
        self._forest, self._time = forest, -1.0
        self._lit: tuple[float, bytes] | None = None
        self._dynamic, self._course = _dynamic_nodes(forest), _course_of(forest)
        self._nodes = _NodeTable(arrays, forest.nodes.gaussians)
        first = np.cumsum([0, *forest.counts])
        self._bounds = [
            _LayerBounds(
                arrays, forest.nodes.gaussians, int(first[n]), int(first[n + 1]), bool(len(self._dynamic))
            )
            for n in range(len(forest.counts))
        ]
        self._key: tuple[bytes, float] | None = None
        self._layers: dict[int, LayerFootprints | None] = {}
        # The records of all cached layers, and where each layer begins among them.
        self._records: Records | None = None
        self._first: dict[int, Any] = {}
        self.set_time(0.0)

    def set_time(self, time: float) -> None:
        """Shows the nodes as they are at a time from 0 to 1."""
        if time == self._time:
            return
        self._time = time
        self._move(time)

    def _light(self, camera: Camera) -> None:
        """Gives nodes whose light changes the radiance that a camera, in their coordinates, sees now."""
        light, own = self._forest.light, self._forest.nodes.gaussians
        if light is None or not len(light.nodes):
            return
        eye = camera.position.tobytes() if len(light.sided) else b""
        if self._lit == (self._time, eye):
            return
        factors = light.at(self._time)
        if len(light.sided):
            behind = self._seen_from_behind(light, camera)
            factors[:, light.sided] = torch.where(
                behind, light.behind_at(self._time), factors[:, light.sided]
            )
        self._nodes.light(light.nodes, in_light(own.sh[..., light.nodes], factors))
        self._lit = self._time, eye

    def _seen_from_behind(self, light: LightCourse, camera: Camera) -> torch.Tensor:
        """(B,) whether nodes with two sides are seen from behind where they are now."""
        nodes, own = light.nodes[light.sided], self._forest.nodes.gaussians
        eye = torch.from_numpy(camera.position.copy()).float()
        return seen_from_behind(
            light.normals, own.rotations[:, nodes], self._rotations[:, nodes], self._means[:, nodes], eye
        )

    def _move(self, time: float) -> None:
        """Brings dynamic nodes to where they are at a time."""
        own = self._forest.nodes.gaussians
        self._key, self._means, self._rotations = None, own.means, own.rotations
        if self._course is None:
            return
        with torch.no_grad():
            moved = self._course(time)
        self._means = own.means.index_copy(1, self._dynamic, moved.means)
        self._rotations = own.rotations.index_copy(1, self._dynamic, moved.rotations)
        self._nodes.move(self._dynamic, moved)
        for bounds in self._bounds:
            bounds.move(self._dynamic, moved)

    def layers(self, camera: Camera, blur: float, layers: Sequence[int]) -> list[LayerFootprints | None]:
        """The nodes of some layers that may show in a camera's frame; None for a layer without any.

        Args:
            camera: the view.
            blur: widest filter that will be used, as a multiple of the filter at the pixel grid.
            layers: numbers from 1 to L.
        """
        own = self._place.camera(camera)
        self._light(own)
        if self._key is None or self._key[0] != camera.key or self._key[1] < blur:
            self._layers.clear()
            # Rounded up, since the filter's width changes with the gaze.
            self._key = camera.key, 2.0 ** np.ceil(np.log2(blur))
        # A layer at two rates is two images of the same nodes.
        new = [n for n in dict.fromkeys(layers) if n not in self._layers]
        for n in new:
            self._layers[n] = self._visible(own, n, self._key[1])
        if new:
            self._concatenate()
        return [self._layers[n] for n in layers]

    def footprints(self, layers: Sequence[int], chosen: Sequence[Any]) -> Footprints:
        """Footprints of some nodes, one layer after the other.

        Args:
            layers: numbers from 1 to L, each passed to `layers` before.
            chosen: for each of them UInt indices into its `LayerFootprints`; at least one is not empty.
        """
        some = [i + self._first[n] for n, i in zip(layers, chosen, strict=True) if dr.width(i)]
        assert self._records is not None
        return Footprints(**vars(self._records.at(self.arrays.concatenated(some))))

    def _concatenate(self) -> None:
        visible = {n: layer for n, layer in self._layers.items() if layer is not None}
        starts = np.cumsum([0, *(dr.width(layer.x) for layer in visible.values())])
        self._first = {n: self.arrays.number(int(start)) for n, start in zip(visible, starts, strict=False)}
        records = [layer.records for layer in visible.values()]
        self._records = concatenated_records(records) if records else None

    def _visible(self, camera: Camera, layer: int, blur: float) -> LayerFootprints | None:
        """The nodes of a layer that reach into the frame of a camera in their own coordinates."""
        bounds, plain = self._bounds[layer - 1], self.arrays.plain
        if not dr.width(bounds.size):
            return None
        low_pass = PIXEL_FILTER * blur**2
        index = dr.compress(may_show(self.arrays, bounds.means, bounds.size, camera, low_pass))
        if not dr.width(index):
            return None
        raw = footprints(self._nodes.parameters(index + bounds.first), camera)
        records = _FOOTPRINT.pack(self.arrays, **vars(raw))
        dr.eval(records.tables, raw.depth)
        near = records.at(depth_order(self.arrays, raw.depth, plain.Bool(True)))
        extent = 2 * dr.log(dr.maximum(near.opacity * 255, 1))
        ordered = _FOOTPRINT.pack(self.arrays, **vars(near))
        dr.eval(near.x, near.y, near.xx, near.yy, extent, ordered.tables)
        return LayerFootprints(near.x, near.y, near.xx, near.yy, extent, ordered)


def _dynamic_nodes(forest: Forest) -> torch.Tensor:
    """Indices of the nodes that move; none in a forest without a motion."""
    if forest.motion is None:
        return torch.zeros(0, dtype=torch.int64)
    return torch.nonzero(forest.nodes.semantic >= 0)[:, 0]


def _course_of(forest: Forest) -> Callable[[float], Gaussians] | None:
    """The nodes that move, as a function of time; None if there are none."""
    dynamic = _dynamic_nodes(forest)
    if forest.motion is None or not len(dynamic):
        return None
    return forest.motion.course(forest.nodes.gaussians.select(dynamic), forest.nodes.semantic[dynamic])


def _row(arrays: Arrays, values: torch.Tensor) -> Any:
    """A tensor (N,) as a Dr.Jit float without gradient."""
    return dr.detach(arrays.from_torch(values.contiguous()), preserve_type=False)


class _LayerBounds:
    """Where the N nodes of one layer are and how large: enough to tell which ones may show.

    Attributes:
        first: index of the first one in the forest.
        means: three rows (N,), in the forest's own coordinates.
        size: (N,) longest axis, as a standard deviation.
    """

    def __init__(self, arrays: Arrays, gaussians: Gaussians, first: int, end: int, moves: bool):
        self._arrays, self._range = arrays, (first, end)
        self.first = arrays.number(first)
        # Shared with the forest, which is at rest.
        means = gaussians.means.clone() if moves else gaussians.means
        self.means = [_row(arrays, row) for row in means[:, first:end]]
        self.size = _row(arrays, _longest(gaussians.log_scales[:, first:end]))

    def move(self, nodes: torch.Tensor, gaussians: Gaussians) -> None:
        """Moves those of some nodes (M,) of the forest that are in this layer to where Gaussians (M) are."""
        first, end = self._range
        own = torch.nonzero((nodes >= first) & (nodes < end))[:, 0]
        if len(own):
            index = self._arrays.plain.UInt((nodes[own] - first).numpy())
            rows = [*self.means, self.size]
            moved = [*gaussians.means[:, own], _longest(gaussians.log_scales[:, own])]
            for row, values in zip(rows, moved, strict=True):
                dr.scatter(row, _row(self._arrays, values), index, mode=dr.ReduceMode.Permute)


def _longest(log_scales: torch.Tensor) -> torch.Tensor:
    """(N,) longest axis of Gaussians with log scales (3, N), as a standard deviation."""
    return log_scales.max(dim=0).values.exp()


class _NodeTable:
    """All parameters of a node side by side, since nodes are gathered from all over the forest."""

    def __init__(self, arrays: Arrays, gaussians: Gaussians):
        coefficients = gaussians.sh.shape[0]
        widths = {"means": 3, "log_scales": 3, "rotations": 4, "opacity_logits": 1, "sh": 3 * coefficients}
        # 2, 1, 2, 5 floats are spare for spherical harmonics of degree 0, 1, 2, 3.
        loads = -(-sum(widths.values()) // _NODE_LOAD)
        layout = RecordLayout([_NODE_LOAD] * loads, (), **widths)
        tensors = {name: t.reshape(widths[name], len(gaussians)).numpy() for name, t in gaussians.tensors()}
        self._arrays, self._coefficients = arrays, coefficients
        self._records = layout.upload(arrays, **tensors)

    def move(self, nodes: torch.Tensor, gaussians: Gaussians) -> None:
        """Gives some nodes (M,) of the forest place, orientation and size of Gaussians (M)."""
        index = self._arrays.plain.UInt(nodes.numpy())
        rows = {name: getattr(gaussians, name) for name in ("means", "rotations", "log_scales")}
        self._records.write(
            index, **{name: [_row(self._arrays, row) for row in tensor] for name, tensor in rows.items()}
        )

    def light(self, nodes: torch.Tensor, sh: torch.Tensor) -> None:
        """Gives some nodes (M,) of the forest other spherical harmonics (K, 3, M)."""
        index = self._arrays.plain.UInt(nodes.numpy())
        self._records.write(index, sh=[_row(self._arrays, row) for row in sh.flatten(0, 1)])

    def parameters(self, index: Any) -> Parameters:
        """Parameters of the nodes at an index (M,)."""
        node = self._records.at(index)
        sh = [node.sh[3 * k : 3 * k + 3] for k in range(self._coefficients)]
        return Parameters(node.means, node.log_scales, node.rotations, node.opacity_logits, sh)
