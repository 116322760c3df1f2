"""Which methods are compared, at which budgets."""

from __future__ import annotations

import pytest

import hybrid.evaluation.entries as entries_module
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from hybrid.base.identity import Journal
from hybrid.evaluation.entries import (
    OTHER_SPP,
    Entry,
    baseline_entries,
    hybrid_entries,
    splat_entries,
)
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.results import OURS, Key
from hybrid.render.frame_settings import FrameSettings
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Costly


def made(tmp_path, monkeypatch, per_ray: float, least: float = 0.0, fixed: float = 0.0) -> list[Entry]:
    """Entries of one family beside ours, which takes 200 ms for 2 rays."""
    ours = Entry(OURS, "fixed", Costly(2.0, 0.0, 100.0))
    family = lambda rays: Costly(max(least, rays), fixed, per_ray)  # noqa: E731
    monkeypatch.setattr(entries_module, "families", lambda tracer, tuning: {"full": family})
    costs = Journal(tmp_path / "costs.json", {})
    return baseline_entries(ours, None, None, [VIEW], Gaze(), costs, lambda done, total: None)  # type: ignore[arg-type]


def test_a_baseline_that_meets_both_budgets_stands_in_both_rows(tmp_path, monkeypatch):
    found = made(tmp_path, monkeypatch, 100.0)
    assert [entry.key for entry in found] == [("full", "equal-rays"), ("full", "equal-time")]
    assert found[0].method.settings == found[1].method.settings


def test_a_cheaper_baseline_gets_more_rays_at_equal_time(tmp_path, monkeypatch):
    at_rays, at_time = made(tmp_path, monkeypatch, 50.0)
    assert at_rays.method.rays(CAMERA, Gaze()) == 2
    assert 3.8 < at_time.method.rays(CAMERA, Gaze()) < 4.2
    assert (at_rays.briefly, at_time.briefly) == (True, False)


@pytest.mark.parametrize(("least", "budget", "briefly"), [(2.05, "equal-rays", True), (2.2, "fixed", False)])
def test_a_baseline_that_takes_more_rays_at_its_cheapest_is_there_at_those(
    tmp_path, monkeypatch, least, budget, briefly
):
    """Up to 3 % more count as equal."""
    first, second = made(tmp_path, monkeypatch, 50.0, least)
    assert (first.budget, first.briefly) == (budget, briefly)
    assert first.method.rays(CAMERA, Gaze()) == least
    assert second.budget == "equal-time"


def test_a_baseline_that_always_takes_longer_is_not_there_at_equal_time(tmp_path, monkeypatch):
    assert [entry.budget for entry in made(tmp_path, monkeypatch, 50.0, fixed=300.0)] == ["equal-rays"]


def test_rays_of_equal_time_are_found_once(tmp_path, monkeypatch):
    """The same baseline is compared ever after, even if it has become quicker since."""
    first = made(tmp_path, monkeypatch, 50.0)[1].method.settings
    assert made(tmp_path, monkeypatch, 25.0)[1].method.settings == first


def test_entries_of_other_settings_have_other_titles():
    one, other = (Entry("full", "equal-time", Costly(rays, 0.0, 1.0)) for rays in (1.0, 2.0))
    assert one.title != other.title
    assert one.title == Entry("full", "equal-time", Costly(1.0, 5.0, 1.0)).title
    assert one.title != Entry("full", "fixed", Costly(1.0, 0.0, 1.0)).title
    assert one.key == Key("full", "equal-time")


@pytest.mark.parametrize("spp", [1, 3])
def test_hybrid_frames_have_all_foveas_and_fused_ones_further_samples(spp):
    settings = EvaluationSettings(FrameSettings(fov_a=30, fov_b=10, spp=spp))
    entries = hybrid_entries(None, settings)
    by_name = {entry.name: entry for entry in entries}
    assert list(by_name)[:3] == ["hybrid, raw", "hybrid, denoised", "hybrid, fused"]
    for mode in FoveaMode:
        used = by_name[f"hybrid, {mode.value}"]
        assert used.method.settings == {"fovea": mode.value, "spp": spp, "fov_a": 30, "fov_b": 10}
        assert not used.briefly
    others = {entry.method.settings["spp"]: entry for entry in entries[3:]}
    assert set(others) == set(OTHER_SPP) - {spp}
    for count, entry in others.items():
        assert entry.name == f"{OURS}, {count} spp"
        assert entry.method.settings["fovea"] == "fused"
        assert entry.briefly
    assert {entry.budget for entry in entries} == {"fixed"}


def test_splats_without_trees_are_there_if_given():
    forest, flat = Costly(0.0, 1.0, 0.0), Costly(0.0, 2.0, 0.0)
    assert [entry.name for entry in splat_entries(forest, None)] == ["splats alone"]
    first, second = splat_entries(forest, flat)
    assert (first.name, first.method) == ("splats alone", forest)
    assert (second.name, second.method, second.budget) == ("3dgs, no forest", flat, "fixed")
