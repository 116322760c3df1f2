"""What a person at the window can choose, and what is asked of the renderer."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from compose.camera.camera import Camera
from compose.eye.acuity import DEFAULT_ACUITY_MODEL
from compose.eye.gaze import Gaze


class Shows(Enum):
    """What the window shows; the values are what it calls it."""

    COMPOSITE = "composite"
    FOVEA = "fovea alone"
    PERIPHERY = "periphery alone"
    PATH_TRACED = "path-traced frame"
    SPLIT = "composite | path-traced"
    LEVELS = "levels and rates"
    DIFFERENCE = "difference to the path-traced frame"

    @property
    def needs_reference(self) -> bool:
        """Whether a whole path-traced frame is in it."""
        return self in (Shows.PATH_TRACED, Shows.SPLIT, Shows.DIFFERENCE)


@dataclass(frozen=True)
class Settings:
    """How frames are made.

    Attributes:
        fov_a, fov_b: radii in percent of the height.
        spp: samples per pixel and frame in the disc.
        acuity model: name of the acuity model from eccentricity to cut-off.
        layers: coarsest and finest layer that may be drawn.
        rate: log2 of pixels per sample along each axis, at least, in the periphery.
        scale: of the rendered frame's sides to the window's.
        target_fps: frames per second for which all of them but the acuity model are chosen anew, frame by frame; None
            leaves them as they are.
    """

    fov_a: float = 15.0
    fov_b: float = 11.25
    spp: int = 1
    acuity_model: str = DEFAULT_ACUITY_MODEL
    layers: tuple[int, int] | None = None
    rate: int = 0
    scale: float = 1.0
    target_fps: float | None = None


@dataclass(frozen=True)
class Request:
    """One frame that is asked for.

    Attributes:
        camera: the view, at the window's own resolution.
        gaze: in fractions of the frame.
        settings: how the frame is made.
        shows: what of it is shown.
        asked: time.perf_counter of the newest movement of the gaze that is in it.
    """

    camera: Camera
    gaze: Gaze
    settings: Settings
    shows: Shows
    asked: float

    @property
    def rendered(self) -> Camera:
        """The camera of the frame as it is rendered."""
        scale = self.settings.scale
        if scale == 1:
            return self.camera
        size = (max(1, round(scale * side)) for side in (self.camera.width, self.camera.height))
        return self.camera.resized(*size)

    def same_picture(self, other: Request | None) -> bool:
        """Whether another request asks for the same frame, at another time perhaps."""
        return (
            other is not None
            and (self.camera is other.camera or self.camera.key == other.camera.key)
            and (self.gaze, self.settings, self.shows) == (other.gaze, other.settings, other.shows)
        )
