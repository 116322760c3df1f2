"""Equal time is found for any cost that grows with rays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from hybrid.evaluation import equal_cost as module
from hybrid.evaluation.equal_cost import TOLERANCE, at_equal_time, relative_time
from hybrid.evaluation.methods import TimedImage
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Costly


@pytest.mark.parametrize("fixed", [0.0, 20.0, 90.0])
@pytest.mark.parametrize("start", [0.02, 0.5, 8.0])
def test_a_cost_that_can_be_met_is_met(fixed, start):
    ours = Costly(1.0, 0.0, 100.0)
    rays = at_equal_time(lambda r: Costly(r, fixed, 100.0), ours, [VIEW], Gaze(), start)
    assert rays is not None
    assert fixed + 100 * rays == pytest.approx(100, rel=TOLERANCE + 0.005)


def test_whole_samples_take_no_longer_than_is_given():
    ours = Costly(1.0, 0.0, 355.0)
    rays = at_equal_time(lambda r: Costly(max(1, int(r)), 10.0, 100.0), ours, [VIEW], Gaze(), 0.5)
    assert rays is not None
    assert int(rays) == 3


def test_what_always_takes_longer_has_no_equal():
    ours = Costly(1.0, 0.0, 50.0)
    family = lambda r: Costly(max(1, int(r)), 10.0, 100.0)  # noqa: E731
    assert at_equal_time(family, ours, [VIEW], Gaze(), 0.5) is None


@pytest.mark.parametrize(("cost", "expected"), [(102.9, 1.0), (103.1, None)])
def test_three_percent_more_are_as_long_and_more_are_not(cost, expected):
    """A baseline that has one setting only."""
    ours = Costly(1.0, 0.0, 100.0)
    rays = at_equal_time(lambda r: Costly(1.0, 0.0, cost), ours, [VIEW], Gaze(), 1.0)
    assert rays == expected


def test_settings_are_timed_once():
    """Rays that give the same whole samples are not timed anew."""
    ours, timed = Costly(1.0, 0.0, 355.0), []

    @dataclass(frozen=True)
    class Counted(Costly):
        def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
            timed.append(self.rays_per_pixel)
            return super().render(view, gaze, seed)

    at_equal_time(lambda r: Counted(max(1, int(r)), 10.0, 100.0), ours, [VIEW], Gaze(), 0.5)
    # One frame warms up; the times of the others do not vary, so that the least number is enough.
    assert len(timed) == 7 * len(set(timed))


@dataclass(frozen=True)
class Sequence:
    """A method whose frames take the given times, one after the other."""

    times: list[float]
    asked: list[tuple[bytes, int]] = field(default_factory=list)

    @property
    def settings(self) -> dict[str, float]:
        return {}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 1.0

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.asked.append((view.key, seed))
        return TimedImage(np.zeros((1, 1, 3), np.float32), {"total": self.times[len(self.asked) - 1]})


def test_a_relative_time_is_the_ratio_of_medians_after_a_frame_that_warms_up(monkeypatch):
    monkeypatch.setattr(module, "_MOST_FRAMES", 5)
    theirs, ours = Sequence([900.0, 7, 8, 6, 90, 1]), Sequence([0.1, 2, 1, 3, 90, 2])
    assert relative_time(theirs, ours, [VIEW], Gaze()) == pytest.approx(7 / 2)
    cameras = [key for key, _ in theirs.asked + ours.asked]
    assert len(set(cameras)) == 12
    assert CAMERA.key not in cameras
    assert [seed for _, seed in theirs.asked] == [seed for _, seed in ours.asked] == [0, 1, 2, 3, 4, 5]


@dataclass(frozen=True)
class Noisy:
    """A method whose frames take about the given time; it remembers what it was asked for."""

    time: float
    noise: float
    seed: int
    asked: list[tuple[Camera, Gaze]] = field(default_factory=list)

    @property
    def settings(self) -> dict[str, float]:
        return {}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 1.0

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.asked.append((view.camera, gaze))
        draw = small.rng(1000 * self.seed + len(self.asked)).normal(0, self.noise)
        return TimedImage(np.zeros((1, 1, 3), np.float32), {"total": self.time * np.exp(draw)})


def test_frames_are_added_until_it_is_decided_whether_times_are_equal():
    """A fifth more is seen at once, 1 % less only with all frames; without noise a few are enough."""
    counts = {}
    for time, noise in ((120.0, 0.02), (99.0, 0.2), (99.0, 0.0)):
        method, ours = Noisy(time, noise, 1), Noisy(100.0, noise, 2)
        relative_time(method, ours, [VIEW], Gaze())
        counts[time, noise] = len(method.asked)
        assert len(method.asked) == len(ours.asked)
    assert counts == {(120.0, 0.02): 7, (99.0, 0.2): 61, (99.0, 0.0): 7}


def test_frames_go_through_the_views_and_along_the_gaze_path():
    views = [VIEW, VIEW.resized(16, 16), VIEW.resized(24, 24)]
    method = Noisy(99.0, 0.2, 1)
    relative_time(method, Noisy(100.0, 0.2, 2), views, Gaze(0.5, 0.5))
    widths = [camera.width for camera, _ in method.asked]
    assert [widths.count(view.camera.width) for view in views] == [21, 20, 20]
    for part in (method.asked[1:13], method.asked):
        x, y = (np.array([getattr(gaze, axis) for _, gaze in part]) for axis in "xy")
        assert np.ptp(x) > 0.25
        assert np.ptp(y) > 0.25
