"""Equal time is found for any cost that grows with rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hybrid.baselines.methods import Made

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.budgets import NEAR, at_equal_time

CAMERA = Camera(np.eye(4), 8, 8, 8.0, 8.0, 4.0, 4.0)


@dataclass(frozen=True)
class Costly:
    """A frame that takes a fixed time and some per ray; nothing is rendered or waited for."""

    rays_per_pixel: float
    fixed: float
    per_ray: float

    @property
    def settings(self) -> dict[str, float | str]:
        return {"rays": self.rays_per_pixel}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.rays_per_pixel

    def make(self, camera: Camera, gaze: Gaze, seed: int) -> Made:
        total = self.fixed + self.per_ray * self.rays_per_pixel
        return Made(np.zeros((8, 8, 3), np.float32), {"total": total})


@pytest.mark.parametrize("fixed", [0.0, 20.0, 90.0])
@pytest.mark.parametrize("start", [0.02, 0.5, 8.0])
def test_a_cost_that_can_be_met_is_met(fixed, start):
    ours = Costly(1.0, 0.0, 100.0)
    rays = at_equal_time(lambda r: Costly(r, fixed, 100.0), ours, CAMERA, Gaze(), start)
    assert rays is not None
    assert fixed + 100 * rays == pytest.approx(100, rel=NEAR + 0.005)


def test_whole_samples_take_no_longer_than_is_given():
    ours = Costly(1.0, 0.0, 355.0)
    rays = at_equal_time(lambda r: Costly(max(1, int(r)), 10.0, 100.0), ours, CAMERA, Gaze(), 0.5)
    assert rays is not None
    assert int(rays) == 3


def test_what_always_takes_longer_has_no_equal():
    ours = Costly(1.0, 0.0, 50.0)
    family = lambda r: Costly(max(1, int(r)), 10.0, 100.0)  # noqa: E731
    assert at_equal_time(family, ours, CAMERA, Gaze(), 0.5) is None
