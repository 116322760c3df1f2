"""Streamed SOG: a folder that viewers load in chunks at several levels of detail (PlayCanvas, version 1).

lod-meta.json    the chunks, and a spatial tree whose leaves name the chunk of each level
0_0/, 0_1/, ...  LEVEL_LEAF: unbundled SOG, meta.json and WebP images; level 0 is the finest
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.files import json_text, whole_folder
from splat.io.other_formats import save_gaussians
from splat.model.gaussians import Gaussians

INDEX = "lod-meta.json"
_VERSION = 1
# Gaussians of the finest level in a leaf, at most: a few megabytes to load at once.
_MOST_IN_LEAF = 1 << 15
# Standard deviations to which the bounds of a leaf reach.
_REACH = 3.0

Points = NDArray[np.float64]


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
        self._means: list[Points] = [level.means.detach().numpy().T.astype(np.float64) for level in levels]
        self.names: list[str] = []
        self._leaves = self._written = 0

    def node(self, chosen: list[NDArray[np.int64]]) -> dict[str, Any]:
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

    def _leaf(self, chosen: list[NDArray[np.int64]]) -> dict[str, Any]:
        lows, highs, entries = [], [], {}
        for number, own in enumerate(chosen):
            if not len(own):
                continue
            gaussians = self._levels[number].select(torch.from_numpy(own))
            name = f"{number}_{self._leaves}"
            _write_chunk(self._part / name, gaussians)
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


def _write_chunk(folder: Path, gaussians: Gaussians) -> None:
    """Writes Gaussians as unbundled SOG."""
    with tempfile.TemporaryDirectory() as temporary:
        packed = Path(temporary) / "chunk.sog"
        save_gaussians(packed, gaussians)
        with zipfile.ZipFile(packed) as archive:
            archive.extractall(folder)
