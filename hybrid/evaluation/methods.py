"""Methods of rendering a frame, behind one interface: hybrid frames, and splats alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import DEFAULTS, FrameSettings
from hybrid.render.periphery import Periphery


@dataclass(frozen=True)
class TimedImage:
    """A frame, (H, W, 3) linear radiance, and its milliseconds per pass and in total."""

    image: Image
    milliseconds: dict[str, float]


class Method(Protocol):
    """A method of rendering frames, together with its settings."""

    @property
    def settings(self) -> dict[str, Any]:
        """Its settings as JSON has them, for tables."""

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        """Expected number of paths per pixel of the frame."""

    def render(self, view: View, gaze: Gaze, seed: int) -> TimedImage:
        """One frame; same seed, same frame on the same machine.

        The scene's step to the view's time is not a part of the milliseconds: it is the same for all.
        """


# From paths per pixel of the frame to a method that takes about as many.
Family = Callable[[float], Method]


@dataclass(frozen=True)
class HybridMethod:
    """Renders hybrid frames with settings whose gaze and camera each frame sets."""

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
        clock = PassClock()
        self.periphery.set_time(view.time)
        image = self.periphery.whole(view.camera, DEFAULTS).numpy()
        clock.lap("splat")
        return TimedImage(image, clock.milliseconds())
