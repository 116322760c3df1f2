"""Baselines at the cost of the hybrid frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.evaluation import equal_cost as module
from hybrid.evaluation.baselines import WarpTuning
from hybrid.evaluation.equal_cost import TOLERANCE, at_equal_time, relative_time, tuned
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


class WithoutSettings:
    """A method of one ray per pixel."""

    @property
    def settings(self) -> dict[str, float]:
        return {}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 1.0


@dataclass(frozen=True)
class Sequence(WithoutSettings):
    """A method whose frames take the given times, one after the other."""

    times: list[float]
    asked: list[tuple[bytes, int]] = field(default_factory=list)

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
class Noisy(WithoutSettings):
    """A method whose frames take about the given time; it remembers what it was asked for."""

    time: float
    noise: float
    seed: int
    asked: list[tuple[Camera, Gaze]] = field(default_factory=list)

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


SIZE = 48
FOVEATION = Foveation(Gaze(), 25, 25)
REFERENCE = small.rng().uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)


@dataclass(frozen=True)
class NoisyImages:
    """A method with that much noise in the fovea and elsewhere."""

    fovea: float
    elsewhere: float
    settings: Any = None

    def rays(self, camera, gaze) -> float:
        return 1.0

    def render(self, view, gaze, seed) -> TimedImage:
        noise = small.rng(seed).normal(0, 1, REFERENCE.shape)
        x = np.arange(SIZE) + 0.5 - SIZE / 2
        inside = (np.hypot(x[:, None], x[None, :]) < 12)[..., None]
        image = REFERENCE + np.where(inside, self.fovea, self.elsewhere) * noise
        return TimedImage(image.astype(np.float32), {"total": 1.0})


@pytest.fixture
def tune(monkeypatch):
    """Tunes methods of known noise; returns the tuning and how often progress was called."""
    monkeypatch.setattr(module, "_F", (0.1, 0.4))
    monkeypatch.setattr(module, "_SHARES", (0.2, 0.5, 0.8))
    steps = []

    def run(
        warps: dict[tuple, NoisyImages],
        enlarged: dict[int, NoisyImages],
        rays: float = 0.3,
        discs: dict[tuple[int, float], NoisyImages] | None = None,
    ):
        monkeypatch.setattr(
            module, "warped", lambda tracer, t, r: warps.get((t.f, t.spp, t.denoised), NoisyImages(0.3, 0.3))
        )
        monkeypatch.setattr(
            module, "enlarged", lambda tracer, spp, r, denoised: enlarged.get(spp, NoisyImages(0.3, 0.3))
        )
        others = discs or {}
        monkeypatch.setattr(
            module,
            "disc_over",
            lambda tracer, f, spp, share, r: others.get((spp, share), NoisyImages(0.3, 0.3)),
        )
        view = VIEW.resized(SIZE, SIZE)
        found = tuned(None, [view] * 2, [REFERENCE] * 2, FOVEATION, rays, lambda *step: steps.append(step))
        return found, steps

    return run


def test_the_best_for_the_frame_and_the_best_for_the_fovea_may_differ(tune):
    best_in_fovea, best_elsewhere = NoisyImages(0.01, 0.15), NoisyImages(0.1, 0.02)
    found, _ = tune(
        {(0.1, 2, True): best_in_fovea, (0.4, 4, False): best_elsewhere}, {4: NoisyImages(0.05, 0.05)}
    )
    assert found.fovea == WarpTuning(0.1, 2, True)
    assert found.frame == WarpTuning(0.4, 4, False)
    assert found.enlarged_spp == 4


def test_enlarged_frames_are_no_rivals_of_warped_ones(tune):
    """The best of all is an enlarged frame: the tuning of RMFR is the best warped one all the same."""
    found, _ = tune({(0.4, 1, False): NoisyImages(0.1, 0.1)}, {2: NoisyImages(0, 0)})
    assert found.frame == found.fovea == WarpTuning(0.4, 1, False)
    assert found.enlarged_spp == 2


def test_a_disc_gets_the_share_that_is_best_for_frame_and_fovea_together(tune):
    """With the samples that are best for enlarged frames."""
    even, sharp, other = NoisyImages(0.1, 0.1), NoisyImages(0.02, 0.4), NoisyImages(0, 0)
    discs = {(4, 0.2): even, (4, 0.8): sharp, (1, 0.5): other}
    found, _ = tune({}, {4: NoisyImages(0.1, 0.1)}, discs=discs)
    assert (found.enlarged_spp, found.disc_share) == (4, 0.2)
    found, _ = tune({}, {4: NoisyImages(0.1, 0.1)}, discs={**discs, (4, 0.8): NoisyImages(0.02, 0.11)})
    assert found.disc_share == 0.8


def test_all_settings_are_tried_on_all_views(tune):
    _, steps = tune({}, {})
    # Two f, three sample counts, denoised or not; three enlarged ones; and three shares.
    assert steps == [(number, 18) for number in range(1, 19)]


@pytest.mark.parametrize(("rays", "counts"), [(0.3, [1, 2, 4]), (1.5, [2, 4]), (4.0, [4]), (4.2, [5])])
def test_fewer_samples_than_rays_are_not_tried(tune, rays, counts):
    """They would need more pixels than the frame has."""
    _, steps = tune({}, {}, rays)
    assert len(steps) == 5 * len(counts) + 3
    found, _ = tune({(0.1, counts[-1], True): NoisyImages(0, 0)}, {}, rays)
    assert found.frame.spp == counts[-1]
