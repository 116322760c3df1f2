"""The hybrid frame as a method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.methods.method import TimedImage


@dataclass(frozen=True)
class HybridMethod:
    """Renders hybrid frames.

    Attributes:
        renderer: of the scene.
        frame_settings: of the frames; each frame sets gaze and camera.
    """

    renderer: Renderer
    frame_settings: FrameSettings

    @property
    def settings(self) -> dict[str, Any]:
        used = self.frame_settings
        return {"fovea": used.fovea.value, "spp": used.spp, "fov_a": used.fov_a, "fov_b": used.fov_b}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        return self.renderer.paths(self._at(camera, gaze)) / (camera.width * camera.height)

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        self.renderer.scene.show(view.time)
        frame = self.renderer.frame(replace(self._at(view.camera, gaze), time=view.time), seed)
        return TimedImage(frame.composite, frame.milliseconds)

    def _at(self, camera: Camera, gaze: Gaze) -> FrameSettings:
        return replace(self.frame_settings, camera=camera, gaze=gaze)
