"""Who is compared, at which budgets."""

from __future__ import annotations

import hybrid.evaluation.entries as entries_module
from compose.eye.gaze import Gaze
from hybrid.evaluation.entries import OURS, Entry, peer_entries
from hybrid.store.journal import Journal
from tests.hybrid.evaluation.test_budgets import CAMERA, Costly


def made(tmp_path, monkeypatch, per_ray: float) -> list[Entry]:
    ours = Entry(OURS, "fixed", Costly(2.0, 0.0, 100.0))
    monkeypatch.setattr(
        entries_module, "families", lambda tracer, tuning: {"full": lambda r: Costly(r, 0.0, per_ray)}
    )
    costs = Journal(tmp_path / "costs.json", {})
    return peer_entries(ours, None, None, CAMERA, Gaze(), costs, lambda done, total: None)  # type: ignore[arg-type]


def test_a_peer_that_meets_both_budgets_stands_in_both_rows(tmp_path, monkeypatch):
    found = made(tmp_path, monkeypatch, 100.0)
    assert [(entry.method, entry.budget) for entry in found] == [
        ("full", "equal-rays"),
        ("full", "equal-time"),
    ]
    assert found[0].peer.settings == found[1].peer.settings


def test_a_cheaper_peer_gets_more_rays_at_equal_time(tmp_path, monkeypatch):
    at_rays, at_time = made(tmp_path, monkeypatch, 50.0)
    assert at_rays.peer.rays(CAMERA, Gaze()) == 2
    assert 3.8 < at_time.peer.rays(CAMERA, Gaze()) < 4.2


def test_entries_of_other_settings_have_other_titles():
    one, other = (Entry("full", "equal-time", Costly(rays, 0.0, 1.0)) for rays in (1.0, 2.0))
    assert one.title != other.title
    assert one.title == Entry("full", "equal-time", Costly(1.0, 5.0, 1.0)).title
