"""Which animation of a glTF file plays, and what it moves (specification, 3.11)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from pathtrace.gltf.accessors import read_array
from pathtrace.gltf.document import Document
from pathtrace.gltf.samplers import Sampler

Array = NDArray[np.float64]

_COLUMNS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}
# Of the whole time, between what is before a step and what is after it.
_STEP = 1e-6


@dataclass(frozen=True)
class Animation:
    """What moves, by the number of the node and its property (translation, rotation, scale, weights)."""

    channels: dict[tuple[int, str], Sampler] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """When its last keyframe is; 0 if nothing moves."""
        return max((float(sampler.times[-1]) for sampler in self.channels.values()), default=0.0)

    def even_times(self, fps: float) -> Array:
        """(T,) equal steps of time in seconds, from 0 to the end, at least so many a second."""
        return np.linspace(0, self.seconds, max(int(np.ceil(self.seconds * fps - 1e-6)), 1) + 1)

    def all_times(self, fps: float) -> Array:
        """(T,) these, all keyframes, and moments before steps, in seconds, ascending."""
        found = [self.even_times(fps)]
        for sampler in self.channels.values():
            found.append(sampler.times)
            if sampler.interpolation == "STEP":
                found.append(sampler.times[1:] - _STEP * self.seconds)
        times = np.unique(np.concatenate(found))
        # Those that are closer are the same but for rounding, and keyframes must ascend.
        return times[np.diff(times, prepend=-np.inf) > 0.1 * _STEP * self.seconds]


def chosen_animation(document: Document, name: str | None, remarks: list[str]) -> Animation:
    """The animation of a name; without one, all of a file that move different things, else the first one.

    Args:
        document: the file.
        name: of an animation, or its number.
        remarks: lines for the user are added to them.

    Raises:
        UserError: there is none of that name, or it moves what does not exist.
    """
    items = document.section("animations")
    names = [str(item.get("name", number)) for number, item in enumerate(items)]
    if name is not None:
        if name not in names:
            known = ", ".join(names) or "none"
            raise UserError(f"--animation {name}: {document.file} has no such animation; it has {known}")
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
        channels[int(target["node"]), target["path"]] = _sampler(document, sampler, target["path"], user)
    return Animation(channels)


def _sampler(document: Document, sampler: dict[str, Any], path: str, user: str) -> Sampler:
    kind = sampler["interpolation"]
    if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise document.refused(f"{user} has the interpolation {kind}; must be LINEAR, STEP or CUBICSPLINE")
    times = read_array(document, sampler["input"], 1, user)[:, 0]
    values = read_array(document, sampler["output"], _COLUMNS[path], user)
    parts = 3 if kind == "CUBICSPLINE" else 1
    # Of each keyframe there are as many weights as morph targets, each in a row of its own.
    if values.size % (len(times) * parts):
        raise document.refused(f"{user} has {len(values)} values for {len(times)} keyframes")
    rows = values.reshape(len(times), parts, -1)
    if path != "weights" and rows.shape[2] != _COLUMNS[path]:
        raise document.refused(f"{user} has {len(values)} values for {len(times)} keyframes")
    try:
        return Sampler(times, rows if parts == 3 else rows[:, 0], kind, path == "rotation")
    except ValueError as error:
        raise document.refused(f"{user} {error}") from error
