"""Makes what the window shows, request by request. All of it runs on one thread."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.eye.display import Display
from compose.fovea.region import Foveation
from compose.image.colour import Image
from hybrid.frame.aovs import frame_layers
from hybrid.frame.frame import Frame
from hybrid.frame.live import LiveRenderer
from hybrid.frame.periphery import Viewing
from hybrid.interactive.converging import ConvergingFrame
from hybrid.interactive.pictures import picture_of
from hybrid.interactive.request import Request, Settings, Shows
from hybrid.output.images import write_bytes, write_layers
from hybrid.runtime.clock import Clock
from hybrid.runtime.memory import give_back
from pathtrace.trace.film import frame_positions

# With one sample at a time, fusing would take most of the time.
_PATIENT_SPP = 6
# The same for the path-traced frame, of which a step is a sixteenth.
_PATIENT_STEPS = 8
# Samples per pixel of the disc after which nobody sees a difference any more.
_ENOUGH = 4096
# Seconds between two times that memory is given back, which takes three to six milliseconds.
_TIDY_EVERY = 2.0
# Side of the frame in which it is looked how far away things are.
_PROBE = 24


@dataclass(frozen=True)
class Shown:
    """What the window gets.

    Attributes:
        picture: (h, w, 3) sRGB.
        request: what was asked.
        frame: the hybrid frame that is in it.
        paths: traced for it.
        milliseconds: per pass that was made for it now, and in all (total).
        reference_spp: samples per pixel of the path-traced frame, where that is in it.
        finished: whether it will get no better.
    """

    picture: NDArray[np.uint8]
    request: Request
    frame: Frame
    paths: int
    milliseconds: dict[str, float]
    reference_spp: int
    finished: bool

    @property
    def spp(self) -> float:
        """Samples per pixel of the disc, those of earlier frames included."""
        count = self.frame.fovea.samples.count
        return float(count.mean()) if len(count) else 0.0


class FrameSource:
    """Frames of one scene.

    Args:
        renderer: of the scene.

    Attributes:
        renderer: the same.
        display: that frames are shown on.
    """

    def __init__(self, renderer: LiveRenderer):
        self.renderer = renderer
        self.display = renderer.periphery.viewing.display
        self._last: Shown | None = None
        self._converging: ConvergingFrame | None = None
        self._seed = 0
        self._tidied = time.monotonic()

    @property
    def camera(self) -> Camera:
        """The scene's own."""
        return self.renderer.tracer.scene.camera

    def distance(self) -> float:
        """How far away things are, on the median over what the scene's own camera sees."""
        small = self.camera.resized(_PROBE, _PROBE)
        found = self.renderer.tracer.hits(small, frame_positions(small)).distance
        seen = found[np.isfinite(found)]
        return float(np.median(seen)) if len(seen) else 1.0

    def show(self, request: Request, patient: bool) -> Shown:
        """What is asked for; the same once more is a little better each time.

        Args:
            request: what.
            patient: whether it may take longer than others, for more samples.
        """
        self._seed += 1
        self._tidy()
        last = self._last if request.same_picture(self._last.request if self._last else None) else None
        frame, paths = self._rendered(request, last.frame if last else None, patient)
        # A frame that is only shown once more has taken nothing.
        anew = last is None or frame is not last.frame
        passes = dict(frame.milliseconds) if anew else {}
        before = passes.pop("total", 0.0)
        clock = Clock()
        reference, more = self._refined(request, patient) if request.shows.needs_reference else (None, 0)
        if reference is not None:
            clock.lap("reference")
        picture = picture_of(request.shows, frame, _shown_of(reference, request.shows))
        clock.lap("picture")
        rest = clock.milliseconds()
        rest["total"] += before
        self._last = Shown(
            picture,
            request,
            frame,
            paths + more,
            passes | rest,
            reference.samples if reference else 0,
            (paths == 0) and (reference is None or reference.complete),
        )
        return self._last

    def forget(self) -> None:
        """The next frame is made as if it were the first one."""
        self._last = None
        self.renderer.forget()

    def save(self, picture: Path, layers: Path) -> None:
        """What was shown last: the picture as PNG, the layers of its frame as EXR."""
        if self._last is None:
            return
        request, frame = self._last.request, self._last.frame
        write_bytes(picture, self._last.picture)
        write_layers(layers, frame_layers(self.renderer, request.rendered, request.gaze, frame))

    def _tidy(self) -> None:
        """Now and then gives back what frames of another size or kind have needed."""
        if time.monotonic() - self._tidied > _TIDY_EVERY:
            give_back()
            self._tidied = time.monotonic()

    def _rendered(self, request: Request, frame: Frame | None, patient: bool) -> tuple[Frame, int]:
        """The hybrid frame, and how many paths were traced for it now."""
        camera, settings = request.rendered, request.settings
        if frame is None:
            self.renderer.periphery.view_as(_viewing(self.display, settings))
            foveation = Foveation(request.gaze, settings.fov_a, settings.fov_b)
            frame = self.renderer.frame(camera, foveation, settings.spp, self._seed)
            return frame, settings.spp * len(frame.region.pixels)
        if _is_finished(frame) or request.shows == Shows.PATH_TRACED:
            return frame, 0
        spp = max(_PATIENT_SPP, settings.spp) if patient else settings.spp
        return self.renderer.refined(camera, frame, spp, self._seed, not patient), spp * len(
            frame.region.pixels
        )

    def _refined(self, request: Request, patient: bool) -> tuple[ConvergingFrame, int]:
        """The path-traced frame of the request's view with more samples, and how many paths those were."""
        camera = request.rendered
        if self._converging is None or self._converging.camera.key != camera.key:
            self._converging = ConvergingFrame(
                self.renderer.tracer, camera, self.renderer.splat_frame(camera)
            )
        steps = 0 if self._converging.complete else _PATIENT_STEPS if patient else 1
        return self._converging, sum(self._converging.refine() for _ in range(steps))


def _viewing(display: Display, settings: Settings) -> Viewing:
    """The viewer of a frame whose pixels are as much larger than the display's as it is scaled down."""
    if settings.scale != 1:
        size = (max(1, round(settings.scale * side)) for side in (display.width, display.height))
        display = replace(display, **dict(zip(("width", "height"), size, strict=True)))
    return Viewing(display, settings.acuity_model, settings.layers, settings.rate)


def _shown_of(reference: ConvergingFrame | None, shows: Shows) -> Image | None:
    """(H, W, 3) what of the path-traced frame is looked at."""
    if reference is None:
        return None
    return reference.denoised() if shows == Shows.DIFFERENCE else reference.image()


def _is_finished(frame: Frame) -> bool:
    """Whether further samples would not be seen."""
    count = frame.fovea.samples.count
    return not len(count) or bool(count.mean() >= _ENOUGH)
