"""What methods of rendering a frame have in common, so that they can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image


@dataclass(frozen=True)
class TimedImage:
    """A frame and what it took.

    Attributes:
        image: (H, W, 3) linear radiance.
        milliseconds: per pass, and in total.
    """

    image: Image
    milliseconds: dict[str, float]


class Method(Protocol):
    """A method of rendering frames, with all its settings."""

    @property
    def settings(self) -> dict[str, Any]:
        """Its settings, for tables."""

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        """Paths per pixel of the frame."""

    def render(self, camera: Camera, gaze: Gaze, seed: int) -> TimedImage:
        """One frame; same seed, same frame."""
