"""Forest files: safetensors with metadata. Nothing is ever unpickled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.camera.place import WORLD, Place
from splat.io.tensors import FORMAT_VERSION, PLACED_VERSION, load_tensors, save_tensors
from splat.model.check import check_forest
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.model.layer import LABELS, Layer

_ATTACHED = "attached."


def save_forest(path: str | Path, forest: Forest) -> None:
    """Writes a forest file atomically.

    Raises:
        UserError: the file cannot be written.
    """
    nodes = forest.nodes
    is_placed = forest.place != WORLD
    place = {"origin": list(forest.place.origin), "unit": forest.place.unit} if is_placed else {}
    metadata = {
        "format_version": PLACED_VERSION if place else FORMAT_VERSION,
        "kind": "forest",
        "layers": list(forest.counts),
        "degree": nodes.gaussians.degree,
        "trained_focal": forest.trained_focal,
        "scene_name": forest.scene_name,
        "scene_hash": forest.scene_hash,
        **place,
    }
    tensors = {name: tensor.detach().cpu() for name, tensor in nodes.gaussians.tensors()}
    tensors |= dict(nodes.labels())
    tensors |= {_ATTACHED + name: tensor for name, tensor in forest.attached.items()}
    save_tensors(Path(path), tensors, metadata)


def load_forest(path: str | Path) -> Forest:
    """Reads a forest file.

    Raises:
        UserError: the file is missing, truncated, corrupt or of another version, it holds numbers that are
            not finite, or its trees are broken.
    """
    path = Path(path)
    tensors, metadata = load_tensors(path)
    if metadata.get("kind") != "forest":
        raise UserError(f"{path}: not a forest file; must be one that a training wrote")
    try:
        gaussians = Gaussians(**{name: tensors[name] for name in Gaussians.__dataclass_fields__})
        forest = Forest(
            Layer(gaussians, *(tensors[name] for name in LABELS)),
            tuple(int(count) for count in metadata["layers"]),
            float(metadata["trained_focal"]),
            str(metadata["scene_name"]),
            str(metadata["scene_hash"]),
            {n.removeprefix(_ATTACHED): t for n, t in tensors.items() if n.startswith(_ATTACHED)},
            _place(metadata),
        )
        check_forest(forest.layers)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: damaged forest file ({error}); train it again") from error
    if not gaussians.is_finite() or not forest.trained_focal > 0:
        raise UserError(f"{path}: the forest holds numbers that are not finite; train it again")
    return forest


def _place(metadata: dict[str, Any]) -> Place:
    """The coordinates of the nodes; those of the world in files that name none."""
    if "unit" not in metadata:
        return WORLD
    x, y, z = (float(value) for value in metadata["origin"])
    return Place((x, y, z), float(metadata["unit"]))
