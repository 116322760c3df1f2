"""What the window asks of the renderer."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from hybrid.frame.settings import FrameSettings


class View(Enum):
    """What the window shows; the values are its labels."""

    COMPOSITE = "composite"
    FOVEA = "fovea alone"
    PERIPHERY = "periphery alone"
    PATH_TRACED = "path-traced frame"
    SPLIT = "composite | path-traced"
    LEVELS = "levels and rates"
    DIFFERENCE = "difference from the path-traced frame"

    @property
    def needs_path_traced(self) -> bool:
        """Whether it shows a whole path-traced frame."""
        return self in (View.PATH_TRACED, View.SPLIT, View.DIFFERENCE)


@dataclass(frozen=True)
class Request:
    """One frame that the window asks for.

    Attributes:
        settings: of the frame, with its camera at the window's resolution.
        view: what to show of the frame.
        gaze_time: time.perf_counter of the newest gaze movement that the settings include.
        target_fps: frames per second for which radius, samples, layers, rate and scale are chosen frame by
            frame; None leaves them as they are.
    """

    settings: FrameSettings
    view: View = View.COMPOSITE
    gaze_time: float = 0.0
    target_fps: float | None = None

    def same_frame(self, other: Request | None) -> bool:
        """Whether another request asks for the same frame, possibly at another time."""
        return other is not None and (self.settings, self.view, self.target_fps) == (
            other.settings,
            other.view,
            other.target_fps,
        )
