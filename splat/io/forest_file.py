"""Forest files: safetensors with metadata. Nothing is ever unpickled.

A file holds exactly the numbers of the forest that it was saved from: compactly if these are numbers that the
compact encoding has (`splat.io.compact`), otherwise as float32.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch

from compose.base.errors import UserError, claimed_scene, one_line
from compose.base.files import under
from compose.camera.coordinate_systems import WORLD, Place
from splat.io.compact import decoded, exactly_encoded
from splat.io.tensors import (
    BLENDED_VERSION,
    COMPACT_VERSION,
    FORMAT_VERSION,
    PLACED_VERSION,
    load_tensors,
    packed,
    save_tensors,
    unpacked,
)
from splat.model.dynamic_light import LightCourse
from splat.model.forest import Forest
from splat.model.gaussians import TENSORS, Blending, Directional, Gaussians
from splat.model.hierarchy import Hierarchy
from splat.model.motion import Dynamics, LearnedMotion, NodeMotion
from splat.model.trees import LABELS, Layer, check_forest

_ATTACHED, _MOTION, _LIGHT, _DIRECTIONAL = "attached.", "motion.", "light.", "directional."
_HIERARCHY, _CHILDREN, _CONTRAST = "hierarchy.", "children", "contrast"
# In the metadata of compact files: type and shape of each packed tensor.
_PACKED = "packed"
_BLENDING = "blending"
_UNIT_TOLERANCE = 1e-6
_TYPES = {"parent": torch.int32, "semantic": torch.int32, "dynamic": torch.bool}
# Each one halves the resolution of the one below.
_MOST_LAYERS = 32


def save_forest(path: str | Path, forest: Forest) -> None:
    """Writes a forest file atomically.

    Raises:
        UserError: the file cannot be written.
    """
    nodes = forest.nodes
    metadata = {
        "format_version": FORMAT_VERSION,
        "kind": "forest",
        "layers": list(forest.counts),
        "degree": nodes.gaussians.degree,
        "trained_focal": forest.trained_focal,
        "scene_name": forest.scene_name,
        "scene_hash": forest.scene_hash,
    }
    if forest.place != WORLD:
        place = {"origin": list(forest.place.origin), "unit": forest.place.unit}
        metadata |= {"format_version": PLACED_VERSION, **place}
    groups = {_ATTACHED: forest.attached}
    for prefix, part in ((_MOTION, forest.motion), (_LIGHT, forest.light)):
        if part is not None:
            groups[prefix] = part.tensors()
    tensors = {prefix + name: t for prefix, group in groups.items() for name, t in group.items()}
    if forest.hierarchy is not None:
        inner = {} if forest.hierarchy.inner is None else _of_gaussians(forest.hierarchy.inner)
        named = {_CHILDREN: forest.hierarchy.children} | inner
        if forest.hierarchy.contrast is not None:
            named[_CONTRAST] = forest.hierarchy.contrast
        tensors |= {_HIERARCHY + name: tensor.detach().cpu() for name, tensor in named.items()}
    codes = exactly_encoded(forest)
    if codes is not None:
        tensors, kinds = packed({**codes, **tensors})
        metadata |= {"format_version": COMPACT_VERSION, _PACKED: kinds}
    else:
        own = _of_gaussians(nodes.gaussians) | dict(nodes.labels())
        if nodes.gaussians.directional is not None:
            metadata["format_version"] = COMPACT_VERSION
        tensors |= {name: tensor.detach().cpu() for name, tensor in own.items()}
    if nodes.gaussians.blending is not Blending.LINEAR:
        metadata |= {"format_version": BLENDED_VERSION, _BLENDING: nodes.gaussians.blending.value}
    save_tensors(Path(path), tensors, metadata)


def _of_gaussians(gaussians: Gaussians) -> dict[str, torch.Tensor]:
    own, further = dict(gaussians.tensors()), gaussians.directional
    if further is not None:
        own |= {_DIRECTIONAL + "index": further.index, _DIRECTIONAL + "sh": further.sh}
    return own


def load_forest(path: str | Path) -> Forest:
    """Reads a forest file.

    Raises:
        UserError: the file is missing, truncated, corrupt or of another version, it holds numbers that are
            not finite, or its trees are broken.
    """
    path = Path(path)
    tensors, metadata = load_tensors(path, "train it again")
    _require_forest(path, metadata)
    try:
        is_packed = _PACKED in metadata
        tensors = unpacked(tensors, metadata[_PACKED]) if is_packed else tensors
        nodes = decoded(tensors) if is_packed else _exact(tensors)
        # Linear in files that name none.
        blending = Blending(metadata.get(_BLENDING, Blending.LINEAR))
        nodes = replace(nodes, gaussians=replace(nodes.gaussians, blending=blending))
        counts, focal = _counts(metadata["layers"]), float(metadata["trained_focal"])
        scene = claimed_scene(metadata["scene_name"], metadata["scene_hash"])
        attached, place = under(_ATTACHED, tensors), _place(metadata)
        motion, light = _motion(tensors), _light(tensors)
        hierarchy = _hierarchy(tensors, counts[-1], blending) if counts else None
        forest = Forest(nodes, counts, focal, *scene, attached, place, motion, light, hierarchy)
        check_forest(forest.layers)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: damaged forest file ({one_line(error)}); train it again") from error
    if not nodes.gaussians.is_finite() or not 0 < forest.trained_focal < math.inf:
        raise UserError(f"{path}: the forest holds numbers that are not finite; train it again")
    return forest


def _motion(tensors: dict[str, torch.Tensor]) -> Dynamics | None:
    found = under(_MOTION, tensors)
    if not found:
        return None
    is_finite = all(bool(torch.isfinite(tensor).all()) for tensor in found.values())
    if "centres" not in found:
        if not is_finite:
            raise ValueError("a learned motion that is not finite")
        try:
            return LearnedMotion.restored(found)
        except RuntimeError as error:
            raise ValueError(f"a learned motion of no known kind: {one_line(error)}") from error
    # Files that earlier versions wrote know of instances of one piece only.
    found.setdefault("pieces", torch.ones(len(found["centres"]), dtype=torch.int64))
    motion = NodeMotion(**{field.name: found[field.name] for field in fields(NodeMotion)})
    if not is_finite:
        raise ValueError("a motion that is not finite")
    if not bool(((motion.rotations.norm(dim=2) - 1).abs() < _UNIT_TOLERANCE).all()):
        raise ValueError("a motion whose rotations are not unit quaternions")
    return motion


def _light(tensors: dict[str, torch.Tensor]) -> LightCourse | None:
    found = under(_LIGHT, tensors)
    if not found:
        return None
    # Files that earlier versions wrote have one factor for all channels, and nodes with one side only.
    if found["factors"].ndim == 2:
        found["factors"] = found["factors"].half()[:, None].repeat(1, 3, 1)
    names = {field.name for field in fields(LightCourse)}
    light = LightCourse(**{name: tensor for name, tensor in found.items() if name in names})
    factors = torch.cat([light.factors.flatten(), light.behind.flatten()])
    if not bool((torch.isfinite(factors) & (factors >= 0)).all()):
        raise ValueError("factors of light that are not finite, or negative")
    return light


def _hierarchy(tensors: dict[str, torch.Tensor], leaves: int, blending: Blending) -> Hierarchy | None:
    """The hierarchy over so many Gaussians, which are blended so; None in a file that has none."""
    found = under(_HIERARCHY, tensors)
    if not found:
        return None
    children = found.pop(_CHILDREN)
    if children.dtype != torch.int32 or children.ndim != 2 or children.shape[1] != 2:
        raise ValueError("a hierarchy that is not pairs of int32 numbers")
    contrast = found.pop(_CONTRAST, None)
    if contrast is not None and not (
        contrast.dtype == torch.float32 and bool((torch.isfinite(contrast) & (contrast > 0)).all())
    ):
        raise ValueError("a hierarchy of contrasts that are not positive numbers of float32")
    inner = replace(_gaussians(found), blending=blending) if found else None
    if inner is not None and not inner.is_finite():
        raise ValueError("a hierarchy of numbers that are not finite")
    hierarchy = Hierarchy(children, inner, contrast)
    hierarchy.parents(leaves)
    return hierarchy


def _place(metadata: dict[str, Any]) -> Place:
    if "unit" not in metadata:
        return WORLD
    x, y, z = (float(value) for value in metadata["origin"])
    return Place((x, y, z), float(metadata["unit"]))


def scene_of_forest(path: Path) -> tuple[str, str]:
    """Name and hash of the scene that a forest file says it is of; reads the header alone.

    UserError if it is no forest file, or its header is damaged.
    """
    _, metadata = load_tensors(path, with_tensors=False)
    _require_forest(path, metadata)
    try:
        return claimed_scene(metadata["scene_name"], metadata["scene_hash"])
    except (KeyError, ValueError) as error:
        raise UserError(f"{path}: damaged forest file ({one_line(error)}); train it again") from error


def _require_forest(path: Path, metadata: dict[str, Any]) -> None:
    if metadata.get("kind") != "forest":
        raise UserError(f"{path}: not a forest file; must be one that a training wrote")


def _exact(tensors: dict[str, torch.Tensor]) -> Layer:
    _require_types(tensors, LABELS)
    return Layer(_gaussians(tensors), *(tensors[name] for name in LABELS))


def _gaussians(tensors: dict[str, torch.Tensor]) -> Gaussians:
    _require_types(tensors, TENSORS)
    found, further = under(_DIRECTIONAL, tensors), None
    if found:
        further = Directional(found["index"], found["sh"])
        if further.sh.dtype != torch.float32:
            raise ValueError(f"directional harmonics are {further.sh.dtype}, expected float32")
    return Gaussians(*(tensors[name] for name in TENSORS), directional=further)


def _require_types(tensors: dict[str, torch.Tensor], names: Iterable[str]) -> None:
    # Kernels would misread another type.
    for name in names:
        expected = _TYPES.get(name, torch.float32)
        if tensors[name].dtype != expected or not tensors[name].ndim:
            raise ValueError(f"{name} is {tensors[name].dtype}, expected an array of {expected}")


def _counts(layers: object) -> tuple[int, ...]:
    """Nodes of each layer; a ValueError if these are no numbers of nodes."""
    if not isinstance(layers, list) or len(layers) > _MOST_LAYERS:
        raise ValueError(f"layers must be a list of at most {_MOST_LAYERS} numbers")
    if not all(type(count) is int and count >= 0 for count in layers):
        raise ValueError("layers must be numbers of nodes")
    return tuple(layers)
