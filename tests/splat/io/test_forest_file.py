"""Forest files: what is written reads back equal, and damage is named."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors import safe_open

from compose.base.errors import UserError
from splat.io.compact import compact
from splat.io.forest_file import load_forest, save_forest
from splat.io.tensors import load_tensors, save_tensors
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import Blending
from splat.model.hierarchy import Hierarchy, hierarchy_of
from splat.model.trees import build_forest, static_layer
from tests.splat.samples import equal, gaussians


def forest() -> Forest:
    layers = build_forest(static_layer(gaussians("overlap", n=20, degree=2)), 0.2, 3)
    return forest_of(layers, 120.5, "somewhere", "ab" * 32)


def test_a_forest_reads_back_equal(tmp_path):
    save_forest(tmp_path / "f.safetensors", forest())
    back = load_forest(tmp_path / "f.safetensors")
    assert equal(back.nodes.gaussians, forest().nodes.gaussians)
    assert back.counts == forest().counts
    for (name, found), (_, expected) in zip(back.nodes.labels(), forest().nodes.labels(), strict=True):
        assert torch.equal(found, expected), name
    # The layers share the memory of all nodes.
    assert back.layers[0].gaussians.means.data_ptr() == back.nodes.gaussians.means.data_ptr()
    assert (back.trained_focal, back.scene_name, back.scene_hash) == (120.5, "somewhere", "ab" * 32)
    assert [p.name for p in tmp_path.iterdir()] == ["f.safetensors"]


def test_attached_tensors_come_back(tmp_path):
    """By name, beside the forest's own; and a path may be a string."""
    attached = {"fusion.weights": torch.arange(6.0).reshape(2, 3), "means": torch.ones(1)}
    made = replace(forest(), attached=attached)
    save_forest(str(tmp_path / "f"), made)
    back = load_forest(str(tmp_path / "f"))
    assert back.attached.keys() == attached.keys()
    assert all(torch.equal(back.attached[name], attached[name]) for name in attached)
    assert equal(back.nodes.gaussians, made.nodes.gaussians)
    assert back.digest() == made.digest()


@pytest.mark.parametrize("rounded", [False, True])
def test_the_hierarchy_comes_back(rounded, tmp_path):
    made = forest()
    made = replace(compact(made) if rounded else made, hierarchy=hierarchy_of(made.layers[-1]))
    save_forest(tmp_path / "f", made)
    back = load_forest(tmp_path / "f")
    assert len(made.hierarchy) > 10
    assert torch.equal(back.hierarchy.children, made.hierarchy.children)
    assert equal(back.hierarchy_nodes.gaussians, made.hierarchy_nodes.gaussians)


@pytest.mark.parametrize("degree", [0, 2])
def test_fitted_inner_nodes_come_back(degree, tmp_path):
    hierarchy = hierarchy_of(forest().layers[-1])
    inner = gaussians("overlap", len(hierarchy), degree)
    inner = inner.turning(torch.arange(len(inner)) % 2 == 0) if degree else inner
    made = replace(forest(), hierarchy=replace(hierarchy, inner=inner))
    save_forest(tmp_path / "f", made)
    assert equal(load_forest(tmp_path / "f").hierarchy.inner, inner)


def test_contrasts_come_back(tmp_path):
    hierarchy = hierarchy_of(forest().layers[-1])
    contrast = torch.linspace(0.1, 3, len(hierarchy))
    save_forest(tmp_path / "f", replace(forest(), hierarchy=replace(hierarchy, contrast=contrast)))
    assert torch.equal(load_forest(tmp_path / "f").hierarchy.contrast, contrast)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, 1])
def test_damaged_contrasts_are_named(value, tmp_path):
    hierarchy = hierarchy_of(forest().layers[-1])
    contrast = torch.full((len(hierarchy),), value)
    save_forest(tmp_path / "f", replace(forest(), hierarchy=replace(hierarchy, contrast=contrast)))
    with pytest.raises(UserError, match=r"damaged forest file .a hierarchy of contrasts"):
        load_forest(tmp_path / "f")


@pytest.mark.parametrize(
    "children", [[[0, 900]], [[0, 1], [1, 2]], [[0, -1]], [[0, 1, 2]], [0, 1], [[0.0, 1.0]]]
)
def test_a_damaged_hierarchy_is_named(children, tmp_path):
    dtype = torch.float32 if isinstance(np.ravel(children)[0], float) else torch.int32
    save_forest(tmp_path / "f", replace(forest(), hierarchy=Hierarchy(torch.tensor(children, dtype=dtype))))
    with pytest.raises(UserError, match=r"damaged forest file .a hierarchy"):
        load_forest(tmp_path / "f")


def test_the_file_has_its_documented_keys(tmp_path):
    """Other programs open it: safetensors with these names, and metadata as JSON under "hybrid"."""
    save_forest(tmp_path / "f", replace(forest(), attached={"x": torch.zeros(1)}))
    with safe_open(tmp_path / "f", framework="pt") as file:
        names, metadata = set(file.keys()), json.loads(file.metadata()["hybrid"])
    gaussians_of = {"means", "log_scales", "rotations", "opacity_logits", "sh"}
    assert names == gaussians_of | {"parent", "semantic", "dynamic", "attached.x"}
    assert re.fullmatch("[0-9a-f]{8}", metadata.pop("crc32"))
    assert metadata.pop("checked") is True
    assert metadata == {
        "format_version": 2,
        "kind": "forest",
        "layers": list(forest().counts),
        "degree": 2,
        "trained_focal": 120.5,
        "scene_name": "somewhere",
        "scene_hash": "ab" * 32,
    }


@pytest.mark.parametrize("rounded", [False, True])
def test_blending_comes_back(rounded, tmp_path):
    """In a version that older programs refuse: they would draw too bright."""
    own = replace(forest().nodes.gaussians, blending=Blending.DISPLAY)
    made = replace(forest(), nodes=replace(forest().nodes, gaussians=own))
    save_forest(tmp_path / "f", compact(made) if rounded else made)
    back = load_forest(tmp_path / "f")
    assert back.finest.blending is Blending.DISPLAY
    tensors, metadata = load_tensors(tmp_path / "f")
    assert (metadata["format_version"], metadata["blending"]) == (5, "display")
    assert back.digest() != replace(back, nodes=forest().nodes).digest()
    save_tensors(tmp_path / "f", tensors, {**metadata, "blending": "dark"})
    with pytest.raises(UserError, match="f: damaged forest file"):
        load_forest(tmp_path / "f")
    # Files of before are of Gaussians that were trained here.
    del metadata["blending"]
    save_tensors(tmp_path / "f", tensors, {**metadata, "format_version": 4})
    assert load_forest(tmp_path / "f").finest.blending is Blending.LINEAR


def some_turning() -> Forest:
    made = forest()
    own = made.nodes.gaussians.turning(torch.arange(len(made.nodes)) % 4 == 0)
    return replace(made, nodes=replace(made.nodes, gaussians=own))


def test_harmonics_that_some_have_come_back(tmp_path):
    """In a version that older programs refuse: they would draw the others alone."""
    save_forest(tmp_path / "f", some_turning())
    assert load_forest(tmp_path / "f").digest() == some_turning().digest()
    tensors, metadata = load_tensors(tmp_path / "f")
    assert tensors["sh"].shape[0] == 1
    assert metadata["format_version"] == 4
    save_forest(tmp_path / "whole", forest())
    assert (tmp_path / "f").stat().st_size < 0.7 * (tmp_path / "whole").stat().st_size


@pytest.mark.parametrize(
    "change",
    [
        {"directional.sh": torch.zeros(8, 3, 1)},
        {"directional.sh": torch.zeros(8, 3, 10, dtype=torch.float64)},
        {"directional.index": torch.zeros(10, dtype=torch.int64)},
        {"directional.index": torch.arange(10).int()},
        {"directional.index": torch.arange(10) + 10**6},
    ],
)
def test_damaged_harmonics_are_named(change, tmp_path):
    save_forest(tmp_path / "f", some_turning())
    tensors, metadata = load_tensors(tmp_path / "f")
    save_tensors(tmp_path / "f", {**tensors, **change}, metadata)
    with pytest.raises(UserError, match="f: damaged forest file"):
        load_forest(tmp_path / "f")


@pytest.mark.parametrize("keep", [0, 7, 100, -1])
def test_a_truncated_forest_is_named(tmp_path, keep):
    path = tmp_path / "f.safetensors"
    save_forest(path, forest())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UserError, match=r"f\.safetensors: truncated or corrupt") as caught:
        load_forest(path)
    assert "\n" not in str(caught.value)


def test_other_files_are_not_forests(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        load_forest(tmp_path / "nowhere")
    save_tensors(tmp_path / "other", {"a": torch.zeros(3)}, {})
    with pytest.raises(UserError, match="not a forest file"):
        load_forest(tmp_path / "other")
    save_tensors(tmp_path / "new", {"a": torch.zeros(3)}, {"format_version": 99, "kind": "forest"})
    with pytest.raises(UserError, match="format version 99"):
        load_forest(tmp_path / "new")


def test_missing_and_wrong_numbers_are_named(tmp_path):
    save_forest(tmp_path / "good", forest())
    tensors, metadata = load_tensors(tmp_path / "good")
    counts = forest().counts
    parent, semantic = tensors["parent"].clone(), tensors["semantic"].clone()
    orphan, crowded, moved = parent.clone(), parent.clone(), semantic.clone()
    orphan[-1] = -1
    crowded[counts[0] : counts[0] + counts[1]] = 0
    moved[-1] = 4
    for broken, changes, complaint in (
        ({k: v for k, v in tensors.items() if k != "sh"}, {}, "damaged"),
        ({**tensors, "means": tensors["means"][:, :5]}, {}, "damaged"),
        ({**tensors, "means": tensors["means"] * float("nan")}, {}, "not finite"),
        ({**tensors, "sh": tensors["sh"].clone().fill_(float("inf"))}, {}, "not finite"),
        (tensors, {"trained_focal": 0}, "not finite"),
        (tensors, {"trained_focal": float("nan")}, "not finite"),
        (tensors, {"trained_focal": None}, "damaged"),
        (tensors, {"layers": []}, "zero layers"),
        (tensors, {"layers": [*counts, 3]}, "do not make up"),
        ({k: v[..., :0] for k, v in tensors.items()}, {"layers": [0]}, "holds no nodes"),
        ({**tensors, "parent": orphan}, {}, "broken tree: node 19 of layer 3 has no parent"),
        ({**tensors, "parent": crowded}, {}, "broken tree: node 1 of layer 1 has no child"),
        ({**tensors, "semantic": moved}, {}, "labels disagree: node 19 of layer 3"),
    ):
        save_tensors(tmp_path / "f", broken, {**metadata, **changes})
        with pytest.raises(UserError, match=complaint) as caught:
            load_forest(tmp_path / "f")
        assert "\n" not in str(caught.value)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        save_forest(tmp_path / "file" / "f", forest())
