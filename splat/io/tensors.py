"""Tensors with metadata in safetensors files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from compose.base.errors import UserError
from compose.base.files import write_whole

FORMAT_VERSION = 2
# That of forests in coordinates of their own, which programs that read version 2 alone would misplace.
PLACED_VERSION = 3


def save_tensors(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, Any]) -> None:
    """Writes tensors and metadata to a safetensors file, atomically.

    Args:
        path: the file.
        tensors: by name.
        metadata: anything that JSON can hold.

    Raises:
        UserError: the file cannot be written.
    """
    contiguous = {name: tensor.contiguous() for name, tensor in tensors.items()}
    write_whole(path, lambda part: save_file(contiguous, part, {"hybrid": json.dumps(metadata)}))


def load_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Reads the tensors and the metadata of a file written by `save_tensors`.

    Raises:
        UserError: the file is missing, truncated, corrupt or of another version.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = json.loads((file.metadata() or {}).get("hybrid", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise UserError(f"{path}: truncated or corrupt ({error})") from error
    version = metadata.get("format_version")
    if version is not None and version not in (FORMAT_VERSION, PLACED_VERSION):
        readable = f"{FORMAT_VERSION} and {PLACED_VERSION}"
        raise UserError(f"{path}: format version {version}, this program reads {readable}")
    return tensors, metadata
