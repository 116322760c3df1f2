"""One row of a sweep: what is rendered, and what it is compared with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from compose.camera.camera import Camera
from compose.camera.view import View
from compose.fovea.mode import FoveaMode
from hybrid.frame.settings import FrameSettings


@dataclass(frozen=True)
class Setting:
    """A hybrid frame of a sweep.

    Attributes:
        camera: the scene's own view, at the size of the frames.
        frame: settings of the frame, apart from gaze and camera.
        varied: the quantities that the sweep varies, by name.
        paper: Foveated Path Culling's (FPC's) ratios for this row, by the names of ours; empty if unknown.
        over_one_spp: whether to compare with the full path-traced frame at one sample per pixel as well.
        views: whose frames are timed and judged, of the same size; only the camera's if empty.
    """

    camera: Camera
    frame: FrameSettings
    varied: dict[str, Any] = field(default_factory=dict)
    paper: dict[str, float] = field(default_factory=dict)
    over_one_spp: bool = False
    views: tuple[View, ...] = ()

    @property
    def seen(self) -> tuple[View, ...]:
        """The views whose frames are timed and judged, at least one."""
        return self.views or (View(self.camera),)

    def from_views(self, views: list[View]) -> Setting:
        """The same, timed and judged in those views, at the size of its frames."""
        size = self.camera.width, self.camera.height
        return replace(self, views=tuple(view.resized(*size) for view in views))

    @property
    def is_denoised(self) -> bool:
        """Whether its fovea, and so the full path-traced frame it is compared with, is denoised."""
        return self.frame.fovea is not FoveaMode.RAW


def varied(row: dict[str, Any]) -> dict[str, Any]:
    """The varied quantities of a sweep's row: all entries before the times."""
    names = list(row)
    return {name: row[name] for name in names[: names.index("ms")]}
