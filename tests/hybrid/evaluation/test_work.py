"""The progress of all kinds of work adds up."""

from __future__ import annotations

import pytest

from hybrid.evaluation.evaluation import WorkProgress
from hybrid.evaluation.evaluation_settings import EvaluationSettings

KINDS = ("references", "tuning", "costs", "quality", "times")


@pytest.fixture
def reports() -> list[tuple[str, float, float]]:
    return []


def progress(reports, **settings: int) -> WorkProgress:
    return WorkProgress(EvaluationSettings(**settings), lambda *report: reports.append(report))


def test_all_work_together_is_the_total(reports):
    work = progress(reports)
    for kind in KINDS:
        for done in range(1, 4):
            work.of(kind)(done, 3)
    assert [kind for kind, _, _ in reports[::3]] == list(KINDS)
    totals = {total for _, _, total in reports}
    assert len(totals) == 1
    shares = [done / total for _, done, total in reports]
    assert shares == sorted(shares)
    assert shares[0] > 0
    assert shares[-1] == pytest.approx(1)


def test_a_kind_of_work_does_not_count_twice(reports):
    work = progress(reports)
    work.of("quality")(1, 2)
    work.of("quality")(1, 2)
    assert reports[0] == reports[1]


def test_more_of_a_kind_weighs_more(reports):
    few, many = progress(reports, repeats=10), progress(reports, repeats=100)
    few.of("times")(1, 1)
    many.of("times")(1, 1)
    assert reports[1][1] == pytest.approx(10 * reports[0][1])
    few, many = progress(reports, width=64), progress(reports, width=128)
    few.of("references")(1, 1)
    many.of("references")(1, 1)
    assert reports[3][1] == pytest.approx(2 * reports[2][1])
