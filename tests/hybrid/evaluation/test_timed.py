"""Times belong to what was timed, along the whole path, and percentiles are of enough frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from hybrid.baselines.methods import Made

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.entries import Entry
from hybrid.evaluation.timed import timed
from hybrid.store.journal import Journal
from tests.hybrid.evaluation.test_budgets import CAMERA


@dataclass(frozen=True)
class Seen:
    """Renders nothing; remembers what it was asked for."""

    spp: int
    cameras: list[Camera] = field(default_factory=list)
    gazes: list[Gaze] = field(default_factory=list)

    @property
    def settings(self) -> dict[str, float | str]:
        return {"spp": self.spp}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.spp

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        self.cameras.append(camera)
        self.gazes.append(gaze)
        return Made(np.zeros((8, 8, 3), np.float32), {"trace": 1.0, "total": float(self.spp)})


def rows(entries: list[Entry], journal: Journal, repeats: int = 120) -> list[dict]:
    return timed(entries, CAMERA, Gaze(0.4, 0.6), repeats, journal, lambda done, total: None)


def test_brief_entries_see_the_whole_path_and_have_no_99th_percentile(tmp_path):
    whole, brief = Seen(1), Seen(2)
    entries = [Entry("whole", "fixed", whole), Entry("brief", "fixed", brief, briefly=True)]
    first, second = rows(entries, Journal(tmp_path / "j.json", {}))
    assert (first["repeats"], second["repeats"]) == (120, 20)
    assert list(first["ms"]) == ["p50", "p95", "p99"]
    assert list(second["ms"]) == ["p50", "p95"]
    for seen in (whole, brief):
        x, y = (np.array([getattr(gaze, axis) for gaze in seen.gazes]) for axis in "xy")
        # The path leads around where the gaze of the evaluation is.
        np.testing.assert_allclose([x.min(), x.max()], [0.25, 0.55], atol=0.01)
        np.testing.assert_allclose([y.min(), y.max()], [0.45, 0.75], atol=0.01)


def test_no_two_frames_in_turn_have_the_same_camera(tmp_path):
    seen = Seen(1)
    rows([Entry("one", "fixed", seen)], Journal(tmp_path / "j.json", {}))
    keys = [camera.key for camera in seen.cameras]
    assert all(a != b for a, b in pairwise(keys))
    corner = np.array([[0.0, 0.0, 5.0]])
    moved = [camera.project(corner)[0] for camera in seen.cameras]
    assert np.abs(np.array(moved) - CAMERA.project(corner)[0]).max() < 0.01


def test_times_of_another_setting_are_not_taken_over(tmp_path):
    file = tmp_path / "j.json"
    rows([Entry("full", "equal-time", Seen(3))], Journal(file, {}), 20)
    again = Seen(3)
    assert rows([Entry("full", "equal-time", again)], Journal(file, {}), 20)[0]["ms"]["p50"] == 3
    assert not again.gazes
    assert rows([Entry("full", "equal-time", Seen(5))], Journal(file, {}), 20)[0]["ms"]["p50"] == 5
