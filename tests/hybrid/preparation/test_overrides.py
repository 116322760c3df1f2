"""Decisions that a user takes instead of a plan."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.preparation.decisions import Decision, parsed
from hybrid.preparation.scene_plan import ScenePlan, overridden


def test_an_item_is_decided_by_the_user():
    depth = Decision("path depth", 9, -1, {"beyond": 0.001}, 1.5, "segments per path")
    plan = ScenePlan("any", "hash", (depth, Decision("degree", 2, 3, {}, 1.8, "harmonics")))
    found = overridden(plan, parsed(["path depth = 12"]))
    assert found.values() == {"path depth": 12, "degree": 2}
    assert found.decisions[0].evidence == {"planned": 9, "beyond": 0.001}
    assert found.decisions[0].gain == 1
    assert found.decisions[1] is plan.decisions[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("degree", "must be NAME=VALUE"),
        ("degree=4", "must be a whole number from 0 to 3"),
        ("degree=-1", "must be a whole number"),
        ("path depth=0", "from 1 to 1000000"),
        ("layers=" + "9" * 5000, "must be a whole number"),
        ("denoising=maybe", "must be denoised or raw"),
        ("motion=still", "the scene decides all else"),
        ("colour=red", "must be one of path depth"),
    ],
)
def test_what_cannot_be_decided_is_refused(text: str, said: str):
    with pytest.raises(UserError, match=said):
        parsed([text])
