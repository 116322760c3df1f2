"""The interface that all methods of rendering a frame share, so that they can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.eye.gaze import Gaze
from compose.image.colour import Image


@dataclass(frozen=True)
class TimedImage:
    """A frame and how long it took.

    Attributes:
        image: (H, W, 3) linear radiance.
        milliseconds: per pass, and in total.
    """

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
