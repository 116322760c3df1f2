"""Streamed SOG: chunks of all levels of detail, each Gaussian in one, under a tree whose bounds hold them."""

from __future__ import annotations

import json
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from splat.io import other_formats
from splat.io.other_formats import load_gaussians, save_streamed
from splat.model.gaussians import Gaussians
from splat.model.hierarchy import hierarchy_of
from splat.model.trees import static_layer
from tests.splat.samples import gaussians

pytest.importorskip("gaussforge", reason="writes SOG; pip install '.[formats]'")


@pytest.fixture(scope="module")
def levels() -> list[Gaussians]:
    leaves = gaussians("overlap", 600, 1)
    return hierarchy_of(static_layer(leaves)).nodes(leaves).levels(3, 4)


@pytest.fixture(scope="module")
def folder(levels, tmp_path_factory) -> Path:
    """Leaves of at most 200 Gaussians of the finest level."""
    place = tmp_path_factory.mktemp("streamed") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(other_formats, "_MOST_IN_LEAF", 200)
        save_streamed(place, levels)
    return place


def leaves(node: dict[str, Any]) -> list[dict[str, Any]]:
    return [leaf for child in node["children"] for leaf in leaves(child)] if "children" in node else [node]


def chunk(folder: Path, name: str, place: Path) -> Gaussians:
    """An unbundled chunk, bundled and read."""
    with zipfile.ZipFile(place, "w") as archive:
        for file in (folder / name).parent.iterdir():
            archive.write(file, file.name)
    return load_gaussians(place)


def test_levels_have_a_quarter_of_the_gaussians_each(levels):
    counts = [len(level) for level in levels]
    assert counts[0] == 600
    assert all(0.15 * fine < coarse <= fine / 4 for fine, coarse in pairwise(counts))


def test_the_index_counts_what_chunks_hold(folder, levels, tmp_path):
    index = json.loads((folder / "lod-meta.json").read_text())
    assert index["version"] == 1
    assert index["lodLevels"] == len(index["counts"]) == 3
    assert index["counts"] == [len(level) for level in levels]
    assert index["count"] == sum(index["counts"])
    found = leaves(index["tree"])
    assert len(found) == 4
    for level in range(3):
        entries = [leaf["lods"][str(level)] for leaf in found if str(level) in leaf["lods"]]
        assert sum(entry["count"] for entry in entries) == index["counts"][level]
        for entry in entries:
            name = index["filenames"][entry["file"]]
            assert entry["offset"] == 0
            assert len(chunk(folder, name, tmp_path / f"{name.split('/')[0]}.sog")) == entry["count"]
    assert sorted(index["filenames"]) == sorted(
        path.relative_to(folder).as_posix() for path in folder.glob("*/meta.json")
    )


def test_gaussians_lie_in_the_bounds_of_their_leaves_and_are_the_same(folder, levels, tmp_path):
    index = json.loads((folder / "lod-meta.json").read_text())
    means = []
    for leaf in leaves(index["tree"]):
        name = index["filenames"][leaf["lods"]["0"]["file"]]
        own = chunk(folder, name, tmp_path / f"{name.split('/')[0]}.sog").means.numpy().T
        assert (own >= leaf["bound"]["min"]).all()
        assert (own <= leaf["bound"]["max"]).all()
        assert (np.array(index["tree"]["bound"]["min"]) <= leaf["bound"]["min"]).all()
        means.append(own)
    found, given = (np.sort(rows, axis=0) for rows in (np.concatenate(means), levels[0].means.numpy().T))
    np.testing.assert_allclose(found, given, atol=2e-3)


def test_a_folder_that_is_not_empty_is_refused(levels, tmp_path):
    (tmp_path / "own.txt").write_text("kept")
    with pytest.raises(UserError, match="exists already"):
        save_streamed(tmp_path, levels)
    assert [path.name for path in tmp_path.iterdir()] == ["own.txt"]


def test_progress_counts_the_gaussians(levels, tmp_path):
    told = []
    save_streamed(tmp_path / "out", levels, lambda done, total: told.append((done, total)))
    assert told[-1] == (sum(map(len, levels)),) * 2


def test_gaussians_in_one_place_are_one_leaf(tmp_path, monkeypatch):
    monkeypatch.setattr(other_formats, "_MOST_IN_LEAF", 8)
    alike = gaussians("overlap", 20, 0)
    alike.means[:] = torch.tensor([[1.0], [2.0], [3.0]])
    assert save_streamed(tmp_path / "out", [alike]) == 1
