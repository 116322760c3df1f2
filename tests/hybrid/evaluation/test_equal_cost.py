"""Baselines at the cost of the hybrid frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.progress import no_progress
from hybrid.evaluation import equal_cost as module
from hybrid.evaluation.baselines import WarpTuning
from hybrid.evaluation.equal_cost import TOLERANCE, rays_at_equal_time, tuned
from hybrid.evaluation.methods import Family, TimedImage
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Costly, Recorder


def met(family: Family, ours: Costly, first: float) -> float | None:
    """The rays of one family at our time."""
    found = rays_at_equal_time({"one": family}, ours, VIEW, Gaze(), {"one": first}, no_progress)
    return found["one"]


@pytest.mark.parametrize("fixed", [0.0, 20.0, 90.0])
@pytest.mark.parametrize("start", [0.02, 0.5, 8.0])
def test_a_cost_that_can_be_met_is_met(fixed, start):
    rays = met(lambda r: Costly(r, fixed, 100.0), Costly(1.0, 0.0, 100.0), start)
    assert rays is not None
    assert fixed + 100 * rays == pytest.approx(100, rel=TOLERANCE)


def whole(fixed: float, per_ray: float) -> Family:
    """A family with whole samples per pixel."""
    return lambda r: Costly(max(1, int(r)), fixed, per_ray)


@pytest.mark.parametrize("start", [0.001, 0.5, 6.0])
def test_whole_samples_take_no_longer_than_is_given(start):
    """Also from rays that are rounded to the same samples over several steps."""
    rays = met(whole(10.0, 100.0), Costly(1.0, 0.0, 355.0), start)
    assert rays is not None
    assert int(rays) == 3


def test_what_always_takes_longer_has_no_equal():
    assert met(whole(10.0, 100.0), Costly(1.0, 0.0, 50.0), 0.5) is None


@pytest.mark.parametrize(("cost", "expected"), [(104.9, 1.0), (105.1, None)])
def test_five_percent_more_are_as_long_and_more_are_not(cost, expected):
    """A baseline that has one setting only."""
    assert met(lambda r: Costly(1.0, 0.0, cost), Costly(1.0, 0.0, 100.0), 1.0) == expected


def test_settings_that_are_far_off_are_left_after_few_frames_and_timed_once():
    timed: list[float] = []

    @dataclass(frozen=True)
    class Counted(Costly):
        def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
            timed.append(self.rays_per_pixel)
            return super().render(view, gaze, seed)

    met(lambda r: Counted(max(1, int(r)), 10.0, 100.0), Costly(1.0, 0.0, 355.0), 0.5)
    # Two frames warm up.
    counts = [timed[2:].count(spp) for spp in dict.fromkeys(timed)]
    assert set(counts) <= {3, 6, 9}
    assert counts[0] == 3


def test_families_take_turns_and_each_ends_by_itself():
    """All see the same gazes in the same order, none a camera of another, and ours comes first."""
    ours, near, far = Recorder(10), Recorder(10), Recorder(50)
    families = {"near": lambda r: near, "far": lambda r: far}
    found = rays_at_equal_time(families, ours, VIEW, Gaze(), {"near": 1.0, "far": 1.0}, no_progress)
    assert found == {"near": 1.0, "far": None}
    # Two frames warm up; a method five times as slow is known after three, an equal one after nine.
    assert (len(ours.gazes), len(near.gazes), len(far.gazes)) == (11, 11, 5)
    assert near.gazes == ours.gazes
    assert far.gazes == ours.gazes[:5]
    keys = [camera.key for one in (ours, near, far) for camera in one.cameras]
    assert len(set(keys)) == len(keys)
    assert CAMERA.key not in keys


@dataclass(frozen=True)
class Noisy(Costly):
    """A method whose times vary by a few percent."""

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        found = super().render(view, gaze, seed)
        factor = np.exp(small.rng(seed).normal(0, 0.02))
        return TimedImage(found.image, {"total": found.milliseconds["total"] * factor})


def test_noise_is_endured():
    rays = met(lambda r: Noisy(r, 30.0, 100.0), Costly(1.0, 0.0, 100.0), 0.1)
    assert rays is not None
    assert 30 + 100 * rays == pytest.approx(100, rel=0.08)


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
