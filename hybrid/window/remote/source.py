"""Frames of a forest whose cut a server chooses: what the window shows of a remote scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from compose.camera.camera import Camera
from hybrid.base.progress import Progress
from hybrid.render.image_files import write_srgb
from hybrid.render.splat_renderer import SplatRenderer
from hybrid.window.messages import Ready, Request, Server, ShownFrame, ShownView
from hybrid.window.remote.client import Cut, Remote
from hybrid.window.window_views import image_of
from pathtrace.scene.backend import select_backend

# Seconds for which a frame that is shown already waits for another cut: less than the eye notices.
_WAIT = 0.03


class RemoteSource:
    """Frames of a server's forest, of splats alone, from the newest cut; the network is never waited for."""

    def __init__(self, remote: Remote):
        self._remote, self._splats = remote, SplatRenderer(remote.forest)
        self._last: ShownFrame | None = None
        self._cut: Cut | None = None
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
        remote.look(camera, settings.gaze, settings.display)
        same = last is not None and request.same_frame(last.request)
        if same and remote.cut is self._cut:
            remote.changed.wait(_WAIT)
        cut = remote.cut
        if cut is not self._cut:
            self._hold(cut)
        elif same and last is not None:
            return self._noted(last)
        settings = replace(
            settings,
            camera=camera,
            level=cut.level if cut else 1.0,
            gaussians=None,
            layers=None,
            acuity_model=remote.welcome.acuity_model,
        )
        frame = self._splats.frame(settings)
        # There is no disc, and no path-traced frame.
        view = ShownView.LEVELS if request.view is ShownView.LEVELS else ShownView.COMPOSITE
        image = image_of(view, frame, None)
        return self._noted(ShownFrame(image, request, frame, 0, frame.milliseconds, 0, finished=False))

    def warped(self, shown: ShownFrame, newest: Camera) -> ShownFrame:
        return shown

    def renew(self, report: Progress) -> bool:
        return False

    def close(self) -> None:
        self._remote.close()

    def save(self, png: Path) -> None:
        if self._last is not None:
            write_srgb(png, self._last.image)
            self._last.frame.save(png.with_suffix(".exr"))

    def _hold(self, cut: Cut | None) -> None:
        """Draws a cut from now on; without one, the coarsest there is."""
        tree = self._remote.tree
        split = np.zeros(tree.inner, np.bool_) if cut is None else cut.split
        self._cut = cut
        self._splats.hold_cut(tree.drawn(split))

    def _noted(self, shown: ShownFrame) -> ShownFrame:
        """What is shown, with what there is to say of the connection."""
        remote, trouble = self._remote, self._remote.trouble
        finished = not trouble and remote.is_current and self._cut is remote.cut
        self._last = replace(shown, finished=finished, notice=trouble and f"not connected: {trouble}")
        return self._last


def prepared_remote(server: Server, backend: str, report: Progress) -> RemoteSource:
    """The source of a server's frames; UserError if it cannot be reached, or refuses the token."""
    select_backend(backend)
    remote = Remote(server)
    remote.wait(report)
    return RemoteSource(remote)
