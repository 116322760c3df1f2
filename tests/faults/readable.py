"""Which files of a folder cannot be read as what their names say."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from safetensors.numpy import load_file

from compose.image.exr import read_channels
from splat.io.tensors import load_tensors


def unreadable(*folders: Path) -> Iterator[Path]:
    """Files that cannot be read; what is still being written, and hidden, does not count."""
    for folder in folders:
        for path in sorted(folder.rglob("[!.]*")):
            if path.is_file() and not _is_readable(path):
                yield path


def _is_readable(path: Path) -> bool:
    try:
        if path.suffix == ".exr":
            read_channels(path)
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".png":
            with Image.open(path) as image:
                image.load()
        elif path.name == "irradiance.safetensors":
            load_file(path)
        elif path.suffix in (".safetensors", ".forest", ".checkpoint"):
            load_tensors(path)
    except Exception:
        return False
    return True
