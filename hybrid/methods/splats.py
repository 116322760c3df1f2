"""Splats alone as a baseline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import DEFAULTS
from hybrid.methods.method import TimedImage
from hybrid.runtime.clock import Clock


@dataclass(frozen=True)
class SplatsAlone:
    """Renders all Gaussians of the finest layer at full rate."""

    periphery: Periphery

    @property
    def settings(self) -> dict[str, Any]:
        return {"gaussians": self.periphery.forest.counts[-1]}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return 0.0

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        clock = Clock()
        self.periphery.set_time(view.time)
        image = self.periphery.whole(view.camera, DEFAULTS).numpy()
        clock.lap("splat")
        return TimedImage(image, clock.milliseconds())
