"""Rows of a sweep: which frames are timed, against which, and what the journal saves."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from compose.base.errors import UserError
from hybrid.base.identity import Journal
from hybrid.evaluation import sweep_run as module
from hybrid.evaluation.sweep_catalogue import Setting, SweepEffort
from hybrid.evaluation.sweep_run import swept

pytestmark = pytest.mark.usefixtures("quick_metrics")
EFFORT = SweepEffort(3, 1, 4)


def rows(base: Setting, **changes: list) -> list[Setting]:
    """One row per value of a frame setting."""
    ((name, values),) = changes.items()
    return [replace(base, frame=replace(base.frame, **{name: v}), varied={name: v}) for v in values]


@pytest.fixture
def measure(corner, rough, tmp_path):
    """Measures rows; steps of progress are kept."""
    steps = []

    def run(settings, with_quality=False, name="journal"):
        journal = Journal(tmp_path / f"{name}.json", {})
        found = swept(
            corner, rough, settings, with_quality, EFFORT, journal, lambda *step: steps.append(step)
        )
        return found, steps

    return run


def test_ratios_are_to_the_full_frame_with_as_many_samples(base, measure, monkeypatch):
    """Hybrid frames of 1 and 2 samples take 10 and 20 ms, full ones 40 and 100 ms."""
    timed = []

    def made_up(methods, repeats, warm_up, progress, reach):
        timed.append((len(methods), repeats, warm_up, reach))
        fixed = [10.0, 20.0, 40.0, 100.0]
        return [[{"trace": 0.5 * ms, "total": ms + n} for n in (-1, 0, 5)] for ms in fixed]

    monkeypatch.setattr(module, "interleaved_passes", made_up)
    settings = [replace(one, over_one_spp=True, paper={"ratio": 7.0}) for one in rows(base, spp=[1, 2])]
    first, second = measure(settings)[0]
    assert (first["ratio"], second["ratio"]) == (4.0, 5.0)
    assert (first["ratio_1spp"], second["ratio_1spp"]) == (4.0, 2.0)
    assert (first["ms"]["p50"], first["full_ms"]["p50"], second["full_ms"]["p50"]) == (10, 40, 100)
    assert first["passes"] == {"trace": 5.0}
    assert first["ratio_interval"][0] <= 4 <= first["ratio_interval"][1]
    assert first["paper"] == {"ratio": 7.0}
    assert (first["spp"], second["spp"]) == (1, 2)
    assert timed == [(4, 3, 1, (0.15, 0.15))]


def test_full_frames_are_denoised_where_the_fovea_is(base, measure, monkeypatch):
    traced = []
    full = module.FullTrace
    monkeypatch.setattr(module, "FullTrace", lambda tracer, *how: (traced.append(how), full(tracer, *how))[1])
    measure(rows(replace(base, over_one_spp=True, frame=replace(base.frame, spp=2)), fovea=["raw", "fused"]))
    assert set(traced) == {(2, False), (2, True), (1, False), (1, True)}


def test_rows_have_all_passes_and_what_their_discs_cover(base, measure):
    found, steps = measure(rows(base, fov_a=[40.0, 90.0]))
    for row in found:
        assert {"region", "detail", "splat", "fill", "trace", "fovea", "blend"} == set(row["passes"])
        assert row["ratio"] == pytest.approx(row["full_ms"]["p50"] / row["ms"]["p50"])
        assert row["repeats"] == 3
        assert "paper" not in row
        assert "ratio_1spp" not in row
        assert "quality" not in row
    # 0.4^2 pi / 1.5 of the frame; the larger disc loses its top, its bottom and its sides.
    assert found[0]["covered"] == pytest.approx(0.335, abs=0.01)
    assert found[1]["covered"] == pytest.approx(0.99, abs=0.02)
    assert steps[-1] == (2000, 2000)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)


def test_every_timed_frame_has_a_camera_of_its_own(base, measure, monkeypatch):
    cameras = []
    hybrid, full = module.HybridMethod.render, module.FullTrace.render
    for kind, render in ((module.HybridMethod, hybrid), (module.FullTrace, full)):
        monkeypatch.setattr(
            kind,
            "render",
            lambda self, view, *rest, render=render: (
                cameras.append(view.camera.key),
                render(self, view, *rest),
            )[1],
        )
    measure(rows(base, fov_a=[40.0, 90.0]))
    assert len(cameras) == len(set(cameras)) == 3 * (3 + 1)
    assert base.camera.key not in cameras


def test_quality_is_measured_where_wanted(base, measure):
    clean = replace(base, frame=replace(base.frame, spp=64))
    found, _ = measure(rows(clean, fov_a=[30.0, 60.0]), with_quality=True)
    for row in found:
        assert 0 < row["quality"]["foveal ssim"] <= 1
        assert row["quality"]["peripheral psnr"] > 5
    # A larger disc leaves less of the frame to rough splats.
    assert found[1]["quality"]["whole psnr"] > found[0]["quality"]["whole psnr"]


def test_an_empty_region_is_refused_before_anything_is_timed(base, measure, monkeypatch):
    def forbidden(*_):
        raise AssertionError("timed")

    monkeypatch.setattr(module, "interleaved_passes", forbidden)
    settings = rows(replace(base, frame=replace(base.frame, fov_b=0.0)), fov_a=[30.0, 0.1])
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        measure(settings, with_quality=True)


def test_rows_of_one_camera_take_turns_and_are_saved_together(base, measure, monkeypatch):
    timed = []
    passes = module.interleaved_passes

    def counted(methods, *rest):
        timed.append(len(methods))
        return passes(methods, *rest)

    monkeypatch.setattr(module, "interleaved_passes", counted)
    first = rows(base, fov_a=[20.0, 40.0])
    other = rows(replace(base, camera=base.camera.resized(36, 24)), fov_a=[20.0, 40.0])
    found, _ = measure(first + other)
    # Two hybrid methods and the full frame that both are compared with.
    assert timed == [3, 3]
    assert [row["fov_a"] for row in found] == [20, 40, 20, 40]
    assert measure(first + other)[0] == json.loads(json.dumps(found))
    assert timed == [3, 3]
