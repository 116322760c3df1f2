"""Baselines are tuned to the settings that look best, for the frame and for the fovea."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.evaluation import equal_cost as tuning
from hybrid.evaluation.equal_cost import tuned
from hybrid.evaluation.methods import TimedImage, WarpTuning
from tests import small
from tests.hybrid.evaluation.fakes import VIEW

SIZE = 48
FOVEATION = Foveation(Gaze(), 25, 25)
REFERENCE = small.rng().uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)


@dataclass(frozen=True)
class Noisy:
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
    monkeypatch.setattr(tuning, "_F", (0.1, 0.4))
    steps = []

    def run(warps: dict[tuple, Noisy], enlarged: dict[int, Noisy], rays: float = 0.3):
        monkeypatch.setattr(
            tuning, "warped", lambda tracer, t, r: warps.get((t.f, t.spp, t.denoised), Noisy(0.3, 0.3))
        )
        monkeypatch.setattr(
            tuning, "enlarged", lambda tracer, spp, r, denoised: enlarged.get(spp, Noisy(0.3, 0.3))
        )
        view = VIEW.resized(SIZE, SIZE)
        found = tuned(None, [view] * 2, [REFERENCE] * 2, FOVEATION, rays, lambda *step: steps.append(step))
        return found, steps

    return run


def test_the_best_for_the_frame_and_the_best_for_the_fovea_may_differ(tune):
    best_in_fovea, best_elsewhere = Noisy(0.01, 0.15), Noisy(0.1, 0.02)
    found, _ = tune({(0.1, 2, True): best_in_fovea, (0.4, 4, False): best_elsewhere}, {4: Noisy(0.05, 0.05)})
    assert found.fovea == WarpTuning(0.1, 2, True)
    assert found.frame == WarpTuning(0.4, 4, False)
    assert found.enlarged_spp == 4


def test_enlarged_frames_are_no_rivals_of_warped_ones(tune):
    """The best of all is an enlarged frame: the tuning of RMFR is the best warped one all the same."""
    found, _ = tune({(0.4, 1, False): Noisy(0.1, 0.1)}, {2: Noisy(0, 0)})
    assert found.frame == found.fovea == WarpTuning(0.4, 1, False)
    assert found.enlarged_spp == 2


def test_all_settings_are_tried_on_all_views(tune):
    _, steps = tune({}, {})
    # Two f, three sample counts, denoised or not; and three enlarged ones.
    assert steps == [(number, 15) for number in range(1, 16)]


@pytest.mark.parametrize(("rays", "counts"), [(0.3, [1, 2, 4]), (1.5, [2, 4]), (4.0, [4]), (4.2, [5])])
def test_fewer_samples_than_rays_are_not_tried(tune, rays, counts):
    """They would need more pixels than the frame has."""
    _, steps = tune({}, {}, rays)
    assert len(steps) == 5 * len(counts)
    found, _ = tune({(0.1, counts[-1], True): Noisy(0, 0)}, {}, rays)
    assert found.frame.spp == counts[-1]
