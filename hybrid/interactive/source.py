"""Renders what the window shows, request by request, all on one thread."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.frame.frame import Frame
from hybrid.frame.live import LiveRenderer
from hybrid.interactive.converging import ConvergingFrame
from hybrid.interactive.request import Request, View
from hybrid.interactive.views import image_of
from hybrid.output.images import write_srgb
from hybrid.runtime.clock import Clock
from hybrid.runtime.memory import release_memory
from pathtrace.scene.surfaces import Surfaces

# With one sample at a time, fusing would take most of the time once nothing moves.
_PATIENT_SPP = 6
# The same for the path-traced frame, of which a step is a sixteenth.
_PATIENT_STEPS = 8
# Samples per pixel of the disc above which nobody sees a difference.
_ENOUGH = 4096
# Seconds between two releases of unused memory, which take three to six milliseconds.
_RELEASE_EVERY = 2.0


@dataclass(frozen=True)
class Shown:
    """What the window receives.

    Attributes:
        image: (h, w, 3) sRGB.
        request: what was asked for, with the settings that were chosen for it.
        frame: the hybrid frame in it.
        paths: traced for it.
        milliseconds: per pass rendered for it now, and in total.
        reference_spp: samples per pixel of the path-traced frame, if it is shown.
        finished: whether it will get no better.
    """

    image: NDArray[np.uint8]
    request: Request
    frame: Frame
    paths: int
    milliseconds: dict[str, float]
    reference_spp: int
    finished: bool

    @property
    def spp(self) -> float:
        """Mean samples per pixel of the disc, those of earlier frames included."""
        count = self.frame.fovea.samples.count
        return float(count.mean()) if len(count) else 0.0


class FrameSource:
    """Frames of one scene.

    Args:
        renderer: of the scene.
    """

    def __init__(self, renderer: LiveRenderer):
        self.renderer = renderer
        self._last: Shown | None = None
        self._converging: ConvergingFrame | None = None
        self._seed = 0
        self._released = time.monotonic()

    @property
    def camera(self) -> Camera:
        """The scene's own camera."""
        return self.renderer.scene.camera

    def distance(self) -> float:
        """Median distance of what the scene's own camera sees, in units of the scene."""
        distance = Surfaces(self.renderer.scene).median_distance(self.camera)
        return distance if np.isfinite(distance) else 1.0

    def show(self, request: Request, quick: bool) -> Shown:
        """The requested image; the same request again yields a slightly better one each time.

        Args:
            request: what to show.
            quick: whether the frame must not take longer for more samples.
        """
        self._seed += 1
        self._release_memory()
        last = self._last if request.same_frame(self._last.request if self._last else None) else None
        frame, paths = self._rendered(request, last.frame if last else None, quick)
        # A frame that is only shown again has taken no time.
        fresh = last is None or frame is not last.frame
        passes = dict(frame.milliseconds) if fresh else {}
        before = passes.pop("total", 0.0)
        clock = Clock()
        converging, more = None, 0
        if request.view.needs_path_traced:
            converging, more = self._converged(frame, quick)
            clock.lap("reference")
        image = image_of(request.view, frame, _path_traced(converging, request.view))
        clock.lap("picture")
        rest = clock.milliseconds()
        rest["total"] += before
        self._last = Shown(
            image,
            request,
            frame,
            paths + more,
            passes | rest,
            converging.samples if converging else 0,
            (paths == 0) and (converging is None or converging.complete),
        )
        return self._last

    def forget(self) -> None:
        """Renders the next frame as if it were the first one."""
        self._last = None
        self.renderer.forget()

    def save(self, image: Path, aovs: Path) -> None:
        """Writes what was shown last: the image as PNG, the AOVs of its frame as EXR."""
        if self._last is not None:
            write_srgb(image, self._last.image)
            self._last.frame.save(aovs)

    def _release_memory(self) -> None:
        """Now and then releases what frames of another size or kind needed."""
        if time.monotonic() - self._released > _RELEASE_EVERY:
            release_memory()
            self._released = time.monotonic()

    def _rendered(self, request: Request, frame: Frame | None, quick: bool) -> tuple[Frame, int]:
        """The hybrid frame, and how many paths were traced for it now."""
        spp = request.settings.spp
        if frame is None:
            frame = self.renderer.frame(request.settings, self._seed)
            return frame, spp * len(frame.region.pixels)
        if _is_finished(frame) or request.view == View.PATH_TRACED:
            return frame, 0
        spp = spp if quick else max(_PATIENT_SPP, spp)
        return self.renderer.refined(frame, spp, self._seed, quick), spp * len(frame.region.pixels)

    def _converged(self, frame: Frame, quick: bool) -> tuple[ConvergingFrame, int]:
        """The path-traced frame of a frame's view with more samples, and how many paths those took."""
        if self._converging is None or self._converging.camera != frame.camera:
            splats = self.renderer.splats(frame.settings)
            self._converging = ConvergingFrame(self.renderer.tracer, frame.camera, splats)
        converging = self._converging
        steps = 0 if converging.complete else 1 if quick else _PATIENT_STEPS
        return converging, sum(converging.refine() for _ in range(steps))


def _path_traced(converging: ConvergingFrame | None, view: View) -> Image | None:
    """(H, W, 3) the path-traced frame as a view shows it."""
    if converging is None:
        return None
    return converging.denoised() if view == View.DIFFERENCE else converging.image()


def _is_finished(frame: Frame) -> bool:
    """Whether further samples would make no visible difference."""
    count = frame.fovea.samples.count
    return not len(count) or bool(count.mean() >= _ENOUGH)
