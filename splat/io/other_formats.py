"""Files of Gaussians by their names: PLY, GLB, and the compressed formats of web viewers.

The last are converted by the library gaussforge. It is native code, which may crash on a damaged file, so it
works in a process of its own.

Streamed SOG (PlayCanvas, version 1) is a folder that viewers load in chunks at several levels of detail:
lod-meta.json has the chunks, and a spatial tree whose leaves name the chunk of each level; 0_0/, 0_1/, ...,
LEVEL_LEAF, are unbundled SOG, meta.json and WebP images. Level 0 is the finest.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.base.errors import UserError, one_line, reading
from compose.base.files import json_text, require_size_below, whole_folder, write_whole
from splat.io.gltf_gaussians import save_glb
from splat.io.ply import load_ply, save_ply
from splat.model.gaussians import Gaussians
from splat.model.points import Ints, rows_of

# The ends of their names: of those that are written here, and of those that gaussforge writes and calls so.
_WRITERS = {"glb": save_glb, "ply": save_ply}
_FORMATS = (*_WRITERS, "ksplat", "sog", "splat", "spz")
# Of a compressed file: a billion Gaussians.
_MOST_BYTES = 1 << 34
# Of a compressed PLY file, enough to name its properties.
_HEADER = 1 << 12
# SPZ has axes right, up and back, PLY right, down and forward (nianticlabs/spz), and gaussforge leaves that
# to its callers: signs under that half turn about x.
_AXES = 1.0, -1.0, -1.0
_HARMONICS = 1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1
_CONVERSION = """
import sys, gaussforge
source, kind, target, wanted = sys.argv[1:]
with open(source, "rb") as file:
    found = gaussforge.GaussForge().convert(file.read(), kind, wanted)
if "error" in found:
    sys.exit(str(found["error"]))
with open(target, "wb") as file:
    file.write(found["data"])
"""


def format_of(path: Path) -> str:
    """The format that a file's name tells; UserError if it tells none that can be written."""
    if path.name.lower().endswith(".compressed.ply"):
        # gaussforge 0.6 gives Gaussians the spherical harmonics of others.
        raise UserError(f"{path}: compressed PLY files are only read; write .ply, .spz or .sog")
    found = next((kind for kind in _FORMATS if path.name.lower().endswith(f".{kind}")), None)
    if found is None:
        raise UserError(f"{path}: must end in {', '.join(f'.{kind}' for kind in _FORMATS)}")
    return found


def load_gaussians(path: Path) -> Gaussians:
    """Reads Gaussians in any of the formats but glTF; a PLY file may have any name.

    UserError as of `load_ply`, if the name tells no format, or gaussforge is needed and not installed.
    """
    head = b""
    if path.is_file():
        with reading(path), path.open("rb") as file:
            require_size_below(path, _MOST_BYTES)
            head = file.read(_HEADER)
    kind = "ply" if head.startswith(b"ply") else format_of(path)
    if b"packed_position" in head:
        kind = "compressed.ply"
    if kind in _WRITERS or not head:
        return load_ply(path)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain.ply"
        _convert(path, kind, plain, "ply", path)
        try:
            found = load_ply(plain)
        except UserError as error:
            raise UserError(str(error).replace(str(plain), str(path))) from error
    return half_turned(found) if kind == "spz" else found


def save_gaussians(path: Path, gaussians: Gaussians) -> None:
    """Writes Gaussians in the format that the name tells.

    UserError as of `save_ply`, if the name tells none, or gaussforge is needed and not installed.
    """
    kind = format_of(path)
    if kind in _WRITERS:
        _WRITERS[kind](path, gaussians)
        return
    with tempfile.TemporaryDirectory() as folder:
        plain, packed = Path(folder) / "plain.ply", Path(folder) / "packed"
        save_ply(plain, half_turned(gaussians) if kind == "spz" else gaussians)
        _convert(plain, "ply", packed, kind, path)
        write_whole(path, lambda part: shutil.copyfile(packed, part))


def half_turned(gaussians: Gaussians) -> Gaussians:
    """The same Gaussians after half a turn about the x axis."""
    sh, (w, x, y, z) = gaussians.all_turning().sh, gaussians.rotations
    return replace(
        gaussians,
        means=gaussians.means * torch.tensor(_AXES)[:, None],
        rotations=torch.stack([-x, w, -z, y]),
        sh=sh * torch.tensor(_HARMONICS[: len(sh)])[:, None, None],
        directional=None,
    )


def _convert(source: Path, kind: str, target: Path, wanted: str, named: Path) -> None:
    if importlib.util.find_spec("gaussforge") is None:
        raise UserError(f"{named}: needs gaussforge; pip install 'foveated-hybrid-renderer[formats]'")
    command = [sys.executable, "-c", _CONVERSION, str(source), kind, str(target), wanted]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        reason = done.stderr.strip().splitlines()[-1:] or [f"its reader ended with {done.returncode}"]
        raise UserError(f"{named}: cannot be converted ({one_line(reason[0])})")


INDEX = "lod-meta.json"
_VERSION = 1
# Gaussians of the finest level in a leaf, at most: a few megabytes to load at once.
_MOST_IN_LEAF = 1 << 15
# Standard deviations to which the bounds of a leaf reach.
_REACH = 3.0


def save_streamed(
    folder: Path,
    levels: Sequence[Gaussians],
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Writes levels of detail in world space, the finest first; how many chunks there are.

    UserError if the folder is not empty or cannot be written, or gaussforge is not installed.
    """
    with whole_folder(folder, INDEX) as part:
        writer = _Writer(part, levels, progress)
        tree = writer.node([np.arange(len(level)) for level in levels])
        counts = [len(level) for level in levels]
        index = {
            "version": _VERSION,
            "asset": {"generator": "foveated-hybrid-renderer"},
            "count": sum(counts),
            "counts": counts,
            "lodLevels": len(levels),
            "filenames": writer.names,
            "tree": tree,
        }
        (part / INDEX).write_text(json_text(index), encoding="utf-8")
    return len(writer.names)


class _Writer:
    """Divides levels of detail by planes, and writes what lies in each leaf."""

    def __init__(self, part: Path, levels: Sequence[Gaussians], progress: Callable[[int, int], None] | None):
        self._part, self._levels, self._progress = part, levels, progress
        self._means = [rows_of(level.means) for level in levels]
        self.names: list[str] = []
        self._leaves = self._written = 0

    def node(self, chosen: list[Ints]) -> dict[str, Any]:
        """The tree over some Gaussians of each level, by their indices; its chunks are written."""
        finest = self._means[0][chosen[0]]
        if len(finest) <= _MOST_IN_LEAF or not np.ptp(finest, axis=0).any():
            return self._leaf(chosen)
        axis = int(np.argmax(np.quantile(finest, 0.9, axis=0) - np.quantile(finest, 0.1, axis=0)))
        plane = np.median(finest[:, axis])
        below = [means[own, axis] < plane for means, own in zip(self._means, chosen, strict=True)]
        sides = (
            [own[side] for own, side in zip(chosen, part, strict=True)]
            for part in (below, map(np.invert, below))
        )
        children = [self.node(side) for side in sides]
        low, high = (
            find([child["bound"][name] for child in children], axis=0).tolist()
            for name, find in (("min", np.min), ("max", np.max))
        )
        return {"bound": {"min": low, "max": high}, "children": children}

    def _leaf(self, chosen: list[Ints]) -> dict[str, Any]:
        lows, highs, entries = [], [], {}
        for number, own in enumerate(chosen):
            if not len(own):
                continue
            gaussians = self._levels[number].select(torch.from_numpy(own))
            name = f"{number}_{self._leaves}"
            with tempfile.TemporaryDirectory() as temporary:
                packed = Path(temporary) / "chunk.sog"
                save_gaussians(packed, gaussians)
                with zipfile.ZipFile(packed) as archive:
                    archive.extractall(self._part / name)
            entries[str(number)] = {"file": len(self.names), "offset": 0, "count": len(own)}
            self.names.append(f"{name}/meta.json")
            means, reach = self._means[number][own], _REACH * gaussians.longest.numpy()[:, None]
            lows.append((means - reach).min(axis=0))
            highs.append((means + reach).max(axis=0))
            self._written += len(own)
            if self._progress is not None:
                self._progress(self._written, sum(map(len, self._levels)))
        self._leaves += 1
        bound = {"min": np.min(lows, axis=0).tolist(), "max": np.max(highs, axis=0).tolist()}
        return {"bound": bound, "lods": entries}
