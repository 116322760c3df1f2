"""Which settings are worth choosing among."""

from __future__ import annotations

from itertools import pairwise

from hybrid.interactive.ladder import candidates, frontier
from hybrid.interactive.request import Settings
from hybrid.plan.controller import Rung


def rung(milliseconds: float, quality: float) -> Rung:
    return Rung(10.0, 1, 4, 0, 1.0, milliseconds, quality)


def test_what_is_slower_and_worse_than_another_is_left_out():
    quick, good, worse, equal, best = rung(20, 7), rung(40, 9), rung(50, 8), rung(60, 9), rung(80, 9.5)
    assert frontier([best, worse, good, quick, equal]) == [quick, good, best]


def test_of_equal_times_the_better_one_stays():
    assert frontier([rung(20, 7), rung(20, 8)]) == [rung(20, 8)]


def test_candidates_differ_and_suit_any_forest():
    for layers in (1, 4):
        wanted = candidates(layers)
        assert len(set(wanted)) == len(wanted)
        assert all(1 <= r.finest <= layers for r in wanted)
    assert len({r.scale for r in candidates(4)}) > 1
    assert len({r.rate for r in candidates(4)}) > 1


def test_a_rung_leaves_law_and_share_of_the_band_alone():
    settings = Settings(20.0, 10.0, 4, "fov-gs", (2, 3), target_fps=30.0)
    chosen = Rung(8.0, 1, 3, 1, 0.5).applied(settings)
    assert (chosen.fov_a, chosen.fov_b, chosen.spp, chosen.layers) == (8.0, 4.0, 1, (1, 3))
    assert (chosen.rate, chosen.scale, chosen.acuity_model, chosen.target_fps) == (1, 0.5, "fov-gs", 30.0)
    assert Rung(8.0, 1, 3, 1, 0.5).applied(Settings(0.0, 0.0)).fov_b == 0


def test_the_frontier_rises():
    found = frontier([rung(t, q) for t in range(1, 30) for q in ((t * 7) % 11, (t * 5) % 13)])
    assert all(a.milliseconds < b.milliseconds and a.quality < b.quality for a, b in pairwise(found))
