"""Shares by sample count, enlargement and denoiser."""

from __future__ import annotations

import pytest
import torch

from compose.fusion.network import COUNTS, ENLARGEMENTS, Fusion, cell_of, shares_at


def numbered() -> torch.Tensor:
    """Shares of the first parent that tell where they come from."""
    shares = Fusion().shares
    for quick in (0, 1):
        for i in range(len(COUNTS)):
            for j in range(len(ENLARGEMENTS)):
                shares[quick, i, j, 1] = 100 * quick + 10 * i + j
    return shares


def at(quick: bool, count: float, enlargement: float) -> float:
    return float(shares_at(numbered(), quick, torch.full((1, 1, 1, 1), count), enlargement)[0, 1, 0, 0])


def test_before_anything_is_tried_all_is_the_network():
    shares = Fusion().shares
    assert shares.shape == (2, 5, 4, 3)
    assert (shares.sum(-1) == 1).all()
    assert (shares[..., 0] == 1).all()


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize(("i", "count"), list(enumerate(COUNTS)))
@pytest.mark.parametrize(("j", "enlargement"), list(enumerate(ENLARGEMENTS)))
def test_in_a_cell_its_own_shares_hold(quick, i, count, j, enlargement):
    assert at(quick, count, enlargement) == pytest.approx(100 * quick + 10 * i + j)


@pytest.mark.parametrize(
    ("count", "enlargement", "expected"),
    [(8, 1, 26), (2**0.5, 1, 6), (1, 2**0.5, 1.5), (4, 2**1.5, 22.5), (0, 1, 1), (1e9, 100, 43), (1, 0.1, 0)],
)
def test_between_cells_shares_are_interpolated_and_beyond_them_constant(count, enlargement, expected):
    assert at(False, count, enlargement) == pytest.approx(expected, abs=0.7 if count == 8 else 0.01)


def test_each_pixel_has_the_shares_of_its_count():
    count = torch.tensor([[1.0, 2.0], [4.0, 64.0]])[None, None]
    found = shares_at(numbered(), False, count, 1.0)
    assert found.shape == (1, 3, 2, 2)
    torch.testing.assert_close(found[0, 1], torch.tensor([[1.0, 11.0], [21.0, 41.0]]))


def test_the_nearest_cell_is_that_of_the_least_ratio():
    assert cell_of(True, 6, 1.3) == (1, 2, 1)
    assert cell_of(False, 12, 3) == (0, 3, 3)
    assert cell_of(False, 0, 9) == (0, 0, 3)
