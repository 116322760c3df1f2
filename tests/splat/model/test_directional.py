"""Harmonics that only some Gaussians have follow them through every operation on sets."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from splat.model.gaussians import Directional, Gaussians, concatenated, written
from splat.model.trees import merge
from tests.splat.samples import equal, gaussians

N = 12


def kept(n: int = N) -> torch.Tensor:
    return torch.arange(n) % 3 == 1


def some(kind: str = "overlap", n: int = N) -> Gaussians:
    """Every third of them turns with the view."""
    return gaussians(kind, n, 2).turning(kept(n))


def whole(kind: str = "overlap", n: int = N) -> Gaussians:
    """The same ones; the others' harmonics are 0."""
    g = gaussians(kind, n, 2)
    return replace(g, sh=torch.cat([g.sh[:1], torch.where(kept(n), g.sh[1:], 0)]))


def test_only_those_that_are_kept_are_stored():
    found = some()
    assert tuple(found.sh.shape) == (1, 3, N)
    assert tuple(found.directional.sh.shape) == (8, 3, 4)
    assert found.directional.index.tolist() == [1, 4, 7, 10]
    assert (found.degree, len(found)) == (2, N)
    assert equal(found.all_turning(), whole())


@pytest.mark.parametrize("keep", [torch.tensor([10, 0, 7, 2]), torch.arange(N) > 4, torch.arange(0)])
def test_selected_ones_keep_theirs(keep):
    found = some().select(keep)
    assert equal(found, whole().select(keep))
    assert (found.directional.index.diff() > 0).all()


def test_a_part_shares_memory():
    found = some().part(3, 9)
    assert equal(found, whole().select(torch.arange(3, 9)))
    found.directional.sh[:] = 5.0
    whole_set = some()
    whole_set.part(3, 9).directional.sh[:] = 5.0
    assert (whole_set.directional.sh[..., 1:3] == 5).all()
    assert not (whole_set.directional.sh[..., [0, 3]] == 5).any()


def test_sets_of_both_kinds_are_joined():
    parts = [some(), gaussians("nearly flat", 5, 2), some("off-screen"), Gaussians.none(2)]
    found = concatenated(parts)
    expected = concatenated([part.all_turning() for part in parts])
    assert equal(found, expected)
    assert len(found.directional) == 4 + 5 + 4


def test_some_are_written_over_others():
    index = torch.tensor([7, 0, 1])
    part = gaussians("nearly flat", 3, 2).turning(torch.tensor([False, True, True]))
    found = written(some(), index, part)
    expected = written(whole(), index, part.all_turning())
    assert equal(found, expected)
    assert found.directional.index.tolist() == [0, 1, 4, 10]


def test_merged_ones_turn_if_one_of_the_two_does():
    a, b = some(), gaussians("nearly flat", N, 2).turning(torch.arange(N) < 2)
    found = merge(a, b)
    assert equal(found, merge(a.all_turning(), b.all_turning()))
    assert found.directional.index.tolist() == [0, 1, 4, 7, 10]


def test_fewer_can_turn_later():
    found = some().turning(torch.arange(N) > 5)
    assert found.directional.index.tolist() == [7, 10]
    assert torch.equal(found.directional.sh, some().directional.sh[..., 2:])


def test_of_degree_0_nothing_turns():
    found = gaussians(n=4, degree=0).turning(torch.ones(4, dtype=torch.bool))
    assert (found.degree, len(found.directional)) == (0, 0)
    assert equal(found, gaussians(n=4, degree=0))


def test_a_harmonic_that_is_not_finite_is_noticed():
    found = some()
    assert found.is_finite()
    found.directional.sh[3, 1, 2] = float("inf")
    assert not found.is_finite()


@pytest.mark.parametrize(
    ("index", "sh", "said"),
    [
        (torch.tensor([1, 2]), torch.zeros(8, 3, 3), "directional harmonics of shape"),
        (torch.tensor([1, 2]), torch.zeros(7, 3, 2), "directional harmonics of shape"),
        (torch.tensor([1, 2]).int(), torch.zeros(8, 3, 2), "not of int64"),
        (torch.tensor([2, 1]), torch.zeros(8, 3, 2), "in ascending order"),
        (torch.tensor([1, 1]), torch.zeros(8, 3, 2), "in ascending order"),
        (torch.tensor([-1, 1]), torch.zeros(8, 3, 2), "of others than 12"),
        (torch.tensor([1, 12]), torch.zeros(8, 3, 2), "of others than 12"),
    ],
)
def test_wrong_ones_are_refused(index, sh, said):
    with pytest.raises(ValueError, match=said):
        replace(some(), directional=Directional(index, sh))


def test_all_harmonics_beside_directional_ones_are_refused():
    with pytest.raises(ValueError, match="beside 9 others"):
        replace(gaussians(n=N, degree=2), directional=some().directional)
