"""Names of methods, budgets and metrics."""

from __future__ import annotations

from hybrid.evaluation.results import (
    EQUAL_RAYS,
    EQUAL_TIME,
    FIXED,
    HALVES,
    HALVES_KEY,
    OURS,
    OURS_KEY,
    Key,
    half_name,
)


def test_a_key_is_labelled_with_its_budget_unless_it_has_none():
    assert Key("full", FIXED).label == "full"
    assert Key("full", EQUAL_TIME).label == "full (equal-time)"
    assert Key("rmfr", EQUAL_RAYS).label == "rmfr (equal-rays)"


def test_keys_are_found_by_what_evaluation_json_has():
    assert {Key("full", FIXED): 1}["full", "fixed"] == 1
    assert tuple(OURS_KEY) == (OURS, "fixed") == ("hybrid, fused", "fixed")
    assert tuple(HALVES_KEY) == (HALVES, "fixed") == ("reference, half against half", "fixed")


def test_halves_have_names_of_their_own():
    assert half_name("flip", 1) == "flip, half 1"
    assert len({"flip", half_name("flip", 1), half_name("flip", 2), half_name("jod", 1)}) == 4
