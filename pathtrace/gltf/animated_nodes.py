"""Where the nodes of a glTF file are while an animation plays (specification, 3.5, 3.11 and appendix C)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from compose.base.errors import UserError
from compose.camera.camera import Array, unit
from pathtrace.gltf.document import Document, read_array

_COLUMNS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}
_PATHS = ("translation", "rotation", "scale")


@dataclass(frozen=True)
class Sampler:
    """Values over time; before the first keyframe and after the last one, they are those of it.

    ValueError if times do not ascend, or are not as many as the values, or a quaternion has no length.
    """

    times: Array  # (K,) of the keyframes in seconds, ascending
    values: Array  # (K, C); (K, 3, C) of cubic splines: in-tangents, values and out-tangents
    interpolation: str  # LINEAR, STEP or CUBICSPLINE
    is_rotation: bool  # whether values are quaternions (x, y, z, w), which turn at a constant speed

    def __post_init__(self) -> None:
        if len(self.times) != len(self.values):
            raise ValueError(f"has {len(self.times)} times for {len(self.values)} values")
        if (np.diff(self.times) <= 0).any():
            raise ValueError("has times that do not ascend")
        if self.is_rotation and not np.linalg.norm(self._keys, axis=1).all():
            raise ValueError("has a quaternion without length")

    @property
    def _keys(self) -> Array:
        """(K, C) values at keyframes."""
        return self.values[:, 1] if self.interpolation == "CUBICSPLINE" else self.values

    def at(self, times: Array) -> Array:
        """(T, C) values at times (T,) in seconds."""
        inside = np.clip(times, self.times[0], self.times[-1])
        if self.interpolation == "STEP" or len(self.times) == 1:
            found = self._keys[np.searchsorted(self.times, inside, side="right") - 1]
        elif self.interpolation == "CUBICSPLINE":
            found = self._cubic(inside)
        elif self.is_rotation:
            return Slerp(self.times, Rotation.from_quat(self.values))(inside).as_quat()
        else:
            found = np.stack([np.interp(inside, self.times, column) for column in self.values.T], axis=1)
        return unit(found, [0.0, 0.0, 0.0, 1.0]) if self.is_rotation else found

    def _cubic(self, times: Array) -> Array:
        """Cubic Hermite splines, whose tangents are per second (C.5)."""
        first = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        span = np.diff(self.times)[first, None]
        u = (times - self.times[first])[:, None] / span
        before, after = self.values[first], self.values[first + 1]
        return (
            (2 * u**3 - 3 * u**2 + 1) * before[:, 1]
            + span * (u**3 - 2 * u**2 + u) * before[:, 2]
            + (3 * u**2 - 2 * u**3) * after[:, 1]
            + span * (u**3 - u**2) * after[:, 0]
        )


@dataclass(frozen=True)
class Animation:
    """What moves, by the number of the node and its property (translation, rotation, scale, weights)."""

    channels: dict[tuple[int, str], Sampler] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """When its last keyframe is, from 0 on; 0 if nothing moves."""
        return max([0.0, *(float(sampler.times[-1]) for sampler in self.channels.values())])


def chosen_animation(document: Document, name: str | None, remarks: list[str]) -> Animation:
    """The animation of a name or number, else all that move different things, else the first one."""
    items = document.section("animations")
    names = [str(item.get("name", number)) for number, item in enumerate(items)]
    if name is not None:
        if name not in names:
            known = ", ".join(names) or "none"
            raise UserError(f"animation {name}: {document.file} has no such animation; it has {known}")
        return _animation(document, items[names.index(name)], name, remarks)
    together = Animation()
    for item, own in zip(items, names, strict=True):
        found = _animation(document, item, own, remarks)
        if found.channels.keys() & together.channels.keys():
            remarks.append(f"the animation {names[0]} plays; --animation chooses from {', '.join(names)}")
            return _animation(document, items[0], names[0], [])
        together.channels.update(found.channels)
    return together


def _animation(document: Document, item: dict[str, Any], name: str, remarks: list[str]) -> Animation:
    channels: dict[tuple[int, str], Sampler] = {}
    for number, channel in enumerate(item["channels"]):
        user = f"animation {name}: channels[{number}]"
        target = channel["target"]
        if "node" not in target or target["path"] not in _COLUMNS:
            remarks.append(f"{user} moves no node, and is left out")
            continue
        document.item("nodes", target["node"], user)
        if not 0 <= channel["sampler"] < len(item["samplers"]):
            raise document.refused(f"{user} refers to samplers[{channel['sampler']}], which does not exist")
        sampler = item["samplers"][int(channel["sampler"])]
        found = _sampler(document, sampler, target["path"], user, remarks)
        channels[int(target["node"]), target["path"]] = found
    return Animation(channels)


def _sampler(
    document: Document, sampler: dict[str, Any], path: str, user: str, remarks: list[str]
) -> Sampler:
    kind = sampler["interpolation"]
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise document.refused(f"{user} has the interpolation {kind}; must be LINEAR, STEP or CUBICSPLINE")
    times = read_array(document, sampler["input"], 1, user)[:, 0]
    values = read_array(document, sampler["output"], _COLUMNS[path], user)
    parts = 3 if kind == "CUBICSPLINE" else 1
    columns, left = divmod(values.size, len(times) * parts)
    # Of each keyframe there are as many weights as morph targets, each in a row of its own.
    if left or (path != "weights" and columns != _COLUMNS[path]):
        raise document.refused(f"{user} has {len(values)} values for {len(times)} keyframes")
    rows = values.reshape(len(times), parts, columns)
    # What comes next at the same time is what is seen from then on.
    last = np.diff(times, append=np.inf) != 0
    if not last.all():
        remarks.append(f"{user} has keyframes at the same time, of which the last one counts")
        times, rows = times[last], rows[last]
    if times[0] < 0:
        remarks.append(f"{user} starts before 0, from which it is played")
    try:
        return Sampler(times, rows if parts == 3 else rows[:, 0], kind, path == "rotation")
    except ValueError as error:
        raise document.refused(f"{user} {error}") from error


class Nodes:
    """Nodes while an animation plays; those that are `shown`, parents first. UserError if not trees."""

    def __init__(self, document: Document, animation: Animation):
        self.animation = animation
        self._items = document.section("nodes")
        self._parents: list[int | None] = [None] * len(self._items)
        children = [[int(child) for child in item.get("children", [])] for item in self._items]
        for parent, own in enumerate(children):
            for child in own:
                document.item("nodes", child, f"nodes[{parent}]")
                if self._parents[child] is not None:
                    raise document.refused(f"nodes[{child}] has two parents")
                self._parents[child] = parent
        self._order = [node for node, parent in enumerate(self._parents) if parent is None]
        roots = self._order.copy()
        for node in self._order:
            self._order += children[node]
        if lost := set(range(len(self._items))) - set(self._order):
            raise document.refused(f"nodes[{min(lost)}] is its own ancestor")
        if document.section("scenes"):
            # The scene that a viewer is to show, the first one if the file does not say.
            scene = document.item("scenes", document.tree.get("scene", 0), "scene")
            roots = [int(node) for node in scene.get("nodes", [])]
            for node in roots:
                document.item("nodes", node, "scene")
        shown = set(roots)
        shown.update(node for node in self._order if self._parents[node] in shown)
        self.shown = [node for node in self._order if node in shown]

    def __len__(self) -> int:
        return len(self._items)

    def to_world(self, times: Array) -> list[Array]:
        """Of each node, (T, 4, 4) at times (T,) in seconds; (1, 4, 4) of those that stand still."""
        found: dict[int, Array] = {}
        for node in self._order:
            own, parent = self._local(node, times), self._parents[node]
            found[node] = own if parent is None else found[parent] @ own
        return [found[node] for node in range(len(self._items))]

    def ancestors(self, node: int) -> list[int]:
        """A node, its parent, and so on."""
        found = [node]
        while (parent := self._parents[found[-1]]) is not None:
            found.append(parent)
        return found

    def weights(self, node: int, default: Array, times: Array) -> Array:
        """(T, M) of a node's M morph targets; (1, M), the default of its mesh, if nothing else says them."""
        if sampler := self.animation.channels.get((node, "weights")):
            return sampler.at(times)
        return np.atleast_2d(np.asarray(self._items[node].get("weights", default), dtype=np.float64))

    def _local(self, node: int, times: Array) -> Array:
        """(T, 4, 4) or (1, 4, 4): translation, rotation and scale, or a matrix."""
        item = self._items[node]
        shift, turn, scale = (self._values(node, item, path, times) for path in _PATHS)
        local = np.tile(np.eye(4), (max(len(shift), len(turn), len(scale)), 1, 1))
        local[:, :3, :3] = Rotation.from_quat(turn).as_matrix() * scale[:, None]
        local[:, :3, 3] = shift
        # Column by column.
        return local @ np.reshape(item["matrix"], (4, 4)).T.astype(np.float64)

    def _values(self, node: int, item: dict[str, Any], path: str, times: Array) -> Array:
        sampler = self.animation.channels.get((node, path))
        found = np.array([item[path]], dtype=np.float64) if sampler is None else sampler.at(times)
        if path == "rotation" and not found.any(axis=1).all():
            return np.array([[0.0, 0.0, 0.0, 1.0]])
        return found
