"""Compact forests: close to what was trained, the same after any number of files, and small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from splat.io.compact import compact, decoded, encoded, exactly_encoded
from splat.io.forest_file import load_forest, save_forest
from splat.io.tensors import load_tensors, save_tensors
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import Directional, Gaussians
from splat.model.trees import Layer, build_forest, static_layer
from tests.extremes import extreme
from tests.splat.samples import KINDS, equal, gaussians


def forest(kind: str = "overlap", n: int = 200, degree: int = 2) -> Forest:
    layers = build_forest(static_layer(gaussians(kind, n=n, degree=degree)), 0.2, 3)
    return forest_of(layers, 120.5, "somewhere", "ab" * 32)


def scaled(made: Forest, factor: float) -> Forest:
    """A forest in which everything is as many times as large."""
    own = made.nodes.gaussians
    larger = replace(own, means=own.means * factor, log_scales=own.log_scales + float(np.log(factor)))
    return replace(made, nodes=replace(made.nodes, gaussians=larger))


def at_one_place(made: Forest) -> Forest:
    own = made.nodes.gaussians
    return replace(made, nodes=replace(made.nodes, gaussians=replace(own, means=torch.zeros_like(own.means))))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_a_compact_forest_is_close_and_reads_back_to_the_bit(kind, degree, tmp_path):
    made = forest(kind, degree=degree)
    small = compact(made)
    for name, bound in (("log_scales", 1 / 64), ("sh", 0.5 / 256 / 0.282)):
        off = getattr(small.nodes.gaussians.all_turning(), name) - getattr(made.nodes.gaussians, name)
        assert off.abs().max() < 1.01 * bound * (1 + getattr(made.nodes.gaussians, name).abs().max())
    moved = (small.nodes.gaussians.means - made.nodes.gaussians.means).norm(dim=0)
    axes = made.nodes.gaussians.log_scales.exp()
    assert (moved < 1.05 * torch.maximum(axes.min(dim=0).values / 16, axes.max(dim=0).values / 1024)).all()
    save_forest(tmp_path / "f", small)
    back = load_forest(tmp_path / "f")
    assert back.digest() == small.digest()
    assert load_tensors(tmp_path / "f")[1]["format_version"] == 4
    for (name, found), (_, expected) in zip(back.nodes.labels(), made.nodes.labels(), strict=True):
        assert torch.equal(found, expected), name


def test_rounding_twice_changes_nothing():
    small = compact(forest())
    assert exactly_encoded(small) is not None
    assert compact(small).digest() == small.digest()


def test_other_numbers_are_stored_exactly(tmp_path):
    made = forest()
    assert exactly_encoded(made) is None
    save_forest(tmp_path / "f", made)
    assert load_forest(tmp_path / "f").digest() == made.digest()


def test_a_sign_of_zero_is_not_lost(tmp_path):
    """Equal numbers of other bits would give another hash."""
    small = compact(forest())
    own = small.nodes.gaussians
    further = own.directional
    assert (further.sh == 0).any()
    signed = Directional(further.index, torch.where(further.sh == 0, -0.0, further.sh))
    negative = replace(own, directional=signed)
    made = replace(small, nodes=replace(small.nodes, gaussians=negative))
    save_forest(tmp_path / "f", made)
    assert load_forest(tmp_path / "f").digest() == made.digest()


def test_a_compact_file_is_small(tmp_path):
    made = forest(n=4000)
    save_forest(tmp_path / "exact", made)
    save_forest(tmp_path / "small", compact(made))
    # Random numbers cannot be packed much.
    assert (tmp_path / "small").stat().st_size < 0.3 * (tmp_path / "exact").stat().st_size


def _one(**changes: torch.Tensor) -> Forest:
    own = gaussians("overlap", n=1, degree=3)
    return forest_of([static_layer(replace(own, **changes))], 100.0, "somewhere", "ab" * 32)


def _same(n: int) -> Forest:
    return forest_of(
        [static_layer(gaussians("overlap", n=1, degree=3).select(torch.zeros(n, dtype=torch.long)))],
        100.0,
        "somewhere",
        "ab" * 32,
    )


EXTREMES = {
    "one node": ("a single Gaussian of degree 3", lambda: _one()),
    "identical nodes": ("3,000 times the same Gaussian", lambda: _same(3000)),
    "nodes at one place": ("a forest whose means are all 0", lambda: at_one_place(forest())),
    "a scene of 1e-4 units": ("a forest, times 1e-4", lambda: scaled(forest(), 1e-4)),
    "a scene of 1e6 units": ("a forest, times 1e6", lambda: scaled(forest(), 1e6)),
    "radiance of 1e12": ("constant harmonics of 3.7e5", lambda: _one(sh=torch.full((16, 3, 1), 3.7e5))),
    "an invisible node": (
        "opacity logits of -1e38",
        lambda: _one(opacity_logits=torch.tensor([-1e38])),
    ),
    "sizes beyond any": ("log scales of -1e38", lambda: _one(log_scales=torch.full((3, 1), -1e38))),
    "a sheet": ("log scales of 0, 0 and -60", lambda: _one(log_scales=torch.tensor([[0.0], [0], [-60]]))),
    "no rotation": ("a quaternion of length 0", lambda: _one(rotations=torch.zeros(4, 1))),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            n, marks=extreme(f"compact file of {n}", given=v[0], expected="finite, the same after a file")
        )
        for n, v in EXTREMES.items()
    ],
)
def test_extreme_forests_are_stored(name, tmp_path, got):
    small = compact(EXTREMES[name][1]())
    own = small.nodes.gaussians
    assert own.is_finite()
    opacity = torch.sigmoid(own.opacity_logits)
    assert (opacity > 0).all()
    assert (opacity < 1).all()
    assert own.log_scales.abs().max() <= 128
    assert exactly_encoded(small) is not None
    save_forest(tmp_path / "f", small)
    assert load_forest(tmp_path / "f").digest() == small.digest()
    got(f"{(tmp_path / 'f').stat().st_size / len(small.nodes):.0f} bytes per node")


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_no_nodes_are_encoded(degree):
    found = decoded(encoded(static_layer(Gaussians.none(degree)), (0,)))
    assert (len(found), found.gaussians.degree) == (0, degree)


def test_numbers_that_are_not_finite_are_refused():
    made = forest()
    made.nodes.gaussians.means[0, 3] = float("nan")
    assert exactly_encoded(made) is None
    with pytest.raises(ValueError, match="not finite"):
        compact(made)


@pytest.mark.parametrize("keep", [0, 7, 100, 5000, -1])
def test_a_truncated_file_is_named(keep, tmp_path):
    save_forest(tmp_path / "f", compact(forest()))
    (tmp_path / "f").write_bytes((tmp_path / "f").read_bytes()[:keep])
    with pytest.raises(UserError, match="f: truncated or corrupt"):
        load_forest(tmp_path / "f")


DAMAGES = {
    "a missing tensor": lambda t, m: t.pop("sh.constant"),
    "no kinds": lambda t, m: m.pop("packed"),
    "another type": lambda t, m: m["packed"].update(opacities=["bool", [_count(m)]]),
    "another shape": lambda t, m: m["packed"].update(log_scales=["int16", [_count(m), 3]]),
    "fewer axes": lambda t, m: m["packed"].update(log_scales=["int16", [3 * _count(m)]]),
    "bytes that are none": lambda t, m: t.update(opacities=t["opacities"][:-5]),
    "tensors that are not bytes": lambda t, m: t.update(opacities=t["opacities"].int()),
    "other parents": lambda t, m: t.update(parent=t["semantic"].clone()),
    "other layers": lambda t, m: m.update(layers=[_count(m), 3]),
    "fewer that turn": lambda t, m: t.update({"sh.turning": t["dynamic"].clone()}),
}


def _count(metadata: dict) -> int:
    return sum(metadata["layers"])


@extreme(
    "damaged compact files", given=f"{len(DAMAGES)} kinds of damage", expected="each refused in one line"
)
def test_damage_is_named(tmp_path, got):
    save_forest(tmp_path / "good", compact(forest()))
    for name, damage in DAMAGES.items():
        tensors, metadata = load_tensors(tmp_path / "good")
        damage(tensors, metadata)
        save_tensors(tmp_path / "f", tensors, metadata)
        with pytest.raises(UserError, match=r"f: damaged forest file .*; train it again$") as caught:
            load_forest(tmp_path / "f")
        assert str(caught.value).isprintable(), name
    got(f"{len(DAMAGES)} refused")


def test_instances_keep_their_labels(tmp_path):
    nodes = gaussians("overlap", n=50, degree=1)
    semantic = torch.arange(50, dtype=torch.int32) * 10_000 - 1
    layer = Layer(nodes, torch.full((50,), -1, dtype=torch.int32), semantic, semantic > 10)
    small = compact(Forest(layer, (50,), 100.0, "somewhere", "ab" * 32))
    save_forest(tmp_path / "f", small)
    back = load_forest(tmp_path / "f").nodes
    assert torch.equal(back.semantic, semantic)
    assert torch.equal(back.dynamic, semantic > 10)
    assert equal(back.gaussians, small.nodes.gaussians)
