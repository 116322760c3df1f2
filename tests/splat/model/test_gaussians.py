"""The parameter set keeps its shapes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from splat.model.gaussians import Blending, Gaussians, apart, concatenated, sh_count
from splat.model.trees import merge
from tests.splat.samples import equal, gaussians


def test_coefficients_per_degree():
    assert [sh_count(degree) for degree in range(4)] == [1, 4, 9, 16]
    assert [gaussians(n=2, degree=degree).degree for degree in range(4)] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("name", "shape", "complaint"),
    [
        ("means", (5, 3), r"means has shape \(5, 3\), expected \(3, 5\)"),
        ("log_scales", (3, 4), r"log_scales has shape \(3, 4\), expected \(3, 5\)"),
        ("rotations", (3, 5), r"rotations has shape \(3, 5\), expected \(4, 5\)"),
        ("opacity_logits", (5, 1), r"expected"),
        ("sh", (2, 3, 5), r"sh has shape \(2, 3, 5\), expected \(K, 3, 5\) with K in 1, 4, 9, 16"),
        ("sh", (25, 3, 5), "K in 1, 4, 9, 16"),
        ("sh", (4, 3, 6), "sh has shape"),
    ],
)
def test_wrong_shapes_are_named(name, shape, complaint):
    tensors = dict(gaussians(n=5, degree=1).tensors()) | {name: torch.zeros(shape)}
    with pytest.raises(ValueError, match=complaint):
        Gaussians(**tensors)


def test_selection_by_index_and_by_mask():
    g = gaussians(n=5, degree=1)
    picked = g.select(torch.tensor([3, 0]))
    assert len(picked) == 2
    assert torch.equal(picked.means, g.means[:, [3, 0]])
    assert torch.equal(picked.sh, g.sh[:, :, [3, 0]])
    assert equal(g.select(torch.tensor([True, False, False, True, False])), g.select(torch.tensor([0, 3])))
    assert all(tensor.is_contiguous() for _, tensor in picked.tensors())
    # A copy: the original does not change with it.
    picked.means[:] = 9
    assert (g.means != 9).all()


def test_parts_make_up_the_whole():
    g = gaussians(n=7)
    parts = [g.select(torch.arange(3)), g.select(torch.arange(3, 3)), g.select(torch.arange(3, 7))]
    assert equal(concatenated(parts), g)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["means", "log_scales", "rotations", "opacity_logits", "sh"])
def test_a_single_bad_number_is_found(name, value):
    g = gaussians(n=5)
    assert g.is_finite()
    getattr(g, name).view(-1)[3] = value
    assert not g.is_finite()


def test_no_gaussians_are_finite():
    assert gaussians(n=3).select(torch.arange(0)).is_finite()


def test_blending_stays_with_gaussians():
    own = replace(gaussians(n=8), blending=Blending.DISPLAY)
    halves = [own.part(0, 4), own.select(torch.arange(4, 8))]
    others = [
        *halves,
        concatenated(halves),
        own.to(torch.device("cpu")),
        apart(own),
        apart(own).all_turning(),
    ]
    others += [apart(own).part(2, 5), concatenated([apart(half) for half in halves]), merge(*halves)]
    assert {other.blending for other in others} == {Blending.DISPLAY}
