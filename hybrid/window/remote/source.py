"""Frames of a forest whose cut a server chooses: what the window shows of a remote scene."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.camera.camera import Camera
from compose.fovea.warping import grid
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.base.progress import Progress
from hybrid.render.image_files import write_srgb
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.window.messages import Ready, Request, Server, ShownFrame, ShownView
from hybrid.window.remote.client import Cut, Remote
from hybrid.window.remote.disc_messages import DiscWanted, StreamedDisc
from hybrid.window.remote.shown_disc import with_disc
from hybrid.window.window_views import image_of, late_warped
from pathtrace.scene.backend import select_backend

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# Seconds for which a disc is shown in views of other places.
_STALE = 1.0
# Seconds for which a frame that is shown already waits for another cut: less than the eye notices.
_WAIT = 0.03


class RemoteSource:
    """Frames of the newest cut and the newest disc of a server; the network is never waited for."""

    def __init__(self, remote: Remote):
        self._remote, self._splats = remote, SplatRenderer(remote.forest)
        self._last: ShownFrame | None = None
        self._cut: Cut | None = None
        self._disc: StreamedDisc | None = None
        self._hold(None)

    @property
    def camera(self) -> Camera:
        return self._remote.welcome.camera

    @property
    def layers(self) -> int:
        return len(self._remote.forest.counts)

    def ready(self) -> Ready:
        welcome = self._remote.welcome
        return Ready(welcome.scene, welcome.camera, welcome.distance, self.layers)

    def show(self, request: Request, quick: bool) -> ShownFrame:
        # Of the cut that is there; finished once that is the one for this view.
        remote, last = self._remote, self._last
        # First: what changes from here on is seen at the next call.
        remote.changed.clear()
        camera, settings = request.settings.resolved(self.camera)
        remote.want(DiscWanted(settings.fov_a, settings.fov_b, settings.spp))
        remote.look(camera, settings.gaze, settings.display)
        same = last is not None and request.same_frame(last.request)
        if same and not self._has_changed(camera):
            remote.changed.wait(_WAIT)
        if same and last is not None and not self._has_changed(camera):
            return self._noted(last)
        cut, self._disc = remote.cut, self._shown_disc(camera)
        if cut is not self._cut:
            self._hold(cut)
        settings = replace(
            settings,
            camera=camera,
            level=cut.level if cut else 1.0,
            gaussians=None,
            layers=None,
            acuity_model=remote.welcome.acuity_model,
        )
        frame = self._splats.frame(settings)
        if self._disc is not None:
            clock = PassClock()
            frame = with_disc(frame, self._disc)
            clock.lap("disc")
            frame = replace(frame, milliseconds=clock.milliseconds(frame.milliseconds))
        # There is no path-traced frame.
        view = ShownView.COMPOSITE if request.view.needs_path_traced else request.view
        image = image_of(view, frame, None)
        return self._noted(ShownFrame(image, request, frame, 0, frame.milliseconds, 0, finished=False))

    def warped(self, shown: ShownFrame, newest: Camera) -> ShownFrame:
        return late_warped(shown, newest, self._nearness)

    def renew(self, report: Progress) -> bool:
        return False

    def close(self) -> None:
        self._remote.close()

    def save(self, png: Path) -> None:
        if self._last is not None:
            write_srgb(png, self._last.image)
            self._last.frame.save(png.with_suffix(".exr"))

    def _nearness(self, camera: Camera) -> Float:
        # There are no surfaces here; for the few milliseconds since a frame was begun, a usual depth will do.
        rows, columns = grid(camera)
        return dr.full(device_arrays().plain.Float, 1 / self._remote.welcome.distance, rows * columns)

    def _has_changed(self, camera: Camera) -> bool:
        """Whether there is another cut or disc to show than the last ones."""
        return self._remote.cut is not self._cut or self._shown_disc(camera) is not self._disc

    def _shown_disc(self, camera: Camera) -> StreamedDisc | None:
        """The newest disc, unless it is old: warped for long, it shows less and less of what is there."""
        disc = self._remote.disc
        if disc is None or disc.camera == camera or time.monotonic() - disc.came < _STALE:
            return disc
        return None

    def _hold(self, cut: Cut | None) -> None:
        """Draws a cut from now on; without one, the coarsest there is."""
        tree = self._remote.tree
        split = np.zeros(tree.inner, np.bool_) if cut is None else cut.split
        self._cut = cut
        self._splats.hold_cut(tree.drawn(split))

    def _noted(self, shown: ShownFrame) -> ShownFrame:
        """What is shown, with what there is to say of the connection."""
        remote, trouble = self._remote, self._remote.trouble
        is_newest = self._cut is remote.cut and self._disc is remote.disc
        finished = not trouble and remote.is_current and is_newest and remote.disc_is_final
        self._last = replace(shown, finished=finished, notice=trouble and f"not connected: {trouble}")
        return self._last


def prepared_remote(server: Server, backend: str, report: Progress) -> RemoteSource:
    """The source of a server's frames; UserError if it cannot be reached, or refuses the token."""
    select_backend(backend)
    remote = Remote(server)
    remote.wait(report)
    return RemoteSource(remote)
