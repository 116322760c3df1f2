"""Equal time is found for any cost that grows with rays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.equal_time import TOLERANCE, at_equal_time, relative_time
from hybrid.methods.method import TimedImage
from tests.hybrid.evaluation.fakes import CAMERA, Costly


@pytest.mark.parametrize("fixed", [0.0, 20.0, 90.0])
@pytest.mark.parametrize("start", [0.02, 0.5, 8.0])
def test_a_cost_that_can_be_met_is_met(fixed, start):
    ours = Costly(1.0, 0.0, 100.0)
    rays = at_equal_time(lambda r: Costly(r, fixed, 100.0), ours, CAMERA, Gaze(), start)
    assert rays is not None
    assert fixed + 100 * rays == pytest.approx(100, rel=TOLERANCE + 0.005)


def test_whole_samples_take_no_longer_than_is_given():
    ours = Costly(1.0, 0.0, 355.0)
    rays = at_equal_time(lambda r: Costly(max(1, int(r)), 10.0, 100.0), ours, CAMERA, Gaze(), 0.5)
    assert rays is not None
    assert int(rays) == 3


def test_what_always_takes_longer_has_no_equal():
    ours = Costly(1.0, 0.0, 50.0)
    family = lambda r: Costly(max(1, int(r)), 10.0, 100.0)  # noqa: E731
    assert at_equal_time(family, ours, CAMERA, Gaze(), 0.5) is None


@pytest.mark.parametrize(("cost", "expected"), [(102.9, 1.0), (103.1, None)])
def test_three_percent_more_are_as_long_and_more_are_not(cost, expected):
    """A baseline that has one setting only."""
    ours = Costly(1.0, 0.0, 100.0)
    rays = at_equal_time(lambda r: Costly(1.0, 0.0, cost), ours, CAMERA, Gaze(), 1.0)
    assert rays == expected


def test_settings_are_timed_once():
    """Rays that give the same whole samples are not timed anew."""
    ours, timed = Costly(1.0, 0.0, 355.0), []

    @dataclass(frozen=True)
    class Counted(Costly):
        def render(self, camera: Camera, gaze: Gaze, seed: int) -> TimedImage:
            timed.append(self.rays_per_pixel)
            return super().render(camera, gaze, seed)

    at_equal_time(lambda r: Counted(max(1, int(r)), 10.0, 100.0), ours, CAMERA, Gaze(), 0.5)
    assert len(timed) == 6 * len(set(timed))


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

    def render(self, camera: Camera, gaze: Gaze, seed: int) -> TimedImage:
        self.asked.append((camera.key, seed))
        return TimedImage(np.zeros((1, 1, 3), np.float32), {"total": self.times[len(self.asked) - 1]})


def test_a_relative_time_is_the_ratio_of_medians_after_a_frame_that_warms_up():
    theirs, ours = Sequence([900.0, 7, 8, 6, 90, 1]), Sequence([0.1, 2, 1, 3, 90, 2])
    assert relative_time(theirs, ours, CAMERA, Gaze()) == pytest.approx(7 / 2)
    cameras = [key for key, _ in theirs.asked + ours.asked]
    assert len(set(cameras)) == 12
    assert CAMERA.key not in cameras
    assert [seed for _, seed in theirs.asked] == [seed for _, seed in ours.asked] == [0, 1, 2, 3, 4, 5]
