"""The window in a cell of a Jupyter notebook: the same page, whose messages travel as those of a widget."""

from __future__ import annotations

import asyncio
import atexit
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compose.base.errors import UserError
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window.learning import ShownScene
from hybrid.window.page import PageSession, PageShell, asset
from hybrid.window.viewer import WindowOptions, viewer_of

if TYPE_CHECKING:
    from anywidget import AnyWidget

_WIDGET = """
export default {
  render({ model, el }) {
    const view = hybridWindow(el, (message) => model.send(message), () => {});
    const receive = (message, buffers) => view.receive(message, buffers[0]);
    model.on('msg:custom', receive);
    model.send({ type: 'hello' });
    return () => model.off('msg:custom', receive);
  },
};
"""
# The windows that are open: one, if there is any.
_open: list[AnyWidget] = []


def show(
    scene: str | Path,
    forest: str | Path | None = None,
    settings: FrameSettings = INTERACTIVE,
    *,
    size: tuple[int, int] = (640, 480),
    target_fps: float | None = None,
    folder: str | Path = ".",
    backend: str = "auto",
) -> AnyWidget:
    """The window of `hybrid demo` as a widget, which a notebook shows where it is the value of a cell.

    The mouse is the gaze; F1 lists the keys. There is one window at a time: another one closes it. The scene
    is loaded, and rendered, on a thread of the kernel.

    Args:
        scene: name of a bundled scene, or path of a Mitsuba 3 XML file.
        forest: its forest file. If None, the best one of the scene at hand, else one that takes seconds;
            better ones follow while they are watched.
        settings: of frames, which the controls change; the view is that of the window.
        size: width and height of the frame in pixels, until the window is resized.
        target_fps: frames per second to keep, by choosing radius, samples, layers, rate and scale.
        folder: for screenshots and gaze traces.
        backend: auto (CUDA if available), cuda or llvm.

    Returns:
        The widget; its `close` ends the window and frees the scene.

    Raises:
        UserError: anywidget is missing, or this is no notebook.

    Examples:
        >>> hybrid.show("room")
    """
    try:
        from anywidget import AnyWidget

        loop = asyncio.get_running_loop()
    except ImportError as error:
        raise UserError("hybrid.show requires: pip install 'foveated-hybrid-renderer[notebook]'") from error
    except RuntimeError as error:
        raise UserError("hybrid.show: this is no notebook; run hybrid demo SCENE") from error
    options = WindowOptions(size, 0.0, Path(folder), target_fps)
    file = None if forest is None else Path(forest)
    viewer = viewer_of(ShownScene(str(scene), backend=backend), file, settings, None, options)
    shell = PageShell(viewer)

    class Window(AnyWidget):
        _esm = asset("window.js") + _WIDGET
        _css = asset("window.css")

        def close(self) -> None:
            """Ends the window."""
            atexit.unregister(self.close)
            if self in _open:
                _open.remove(self)
            shell.close()
            viewer.close()
            super().close()

    for before in tuple(_open):
        before.close()
    widget = Window()
    _open.append(widget)
    # The renderer ends before Python does.
    atexit.register(widget.close)
    widget.on_msg(_Cell(shell, loop).receive)
    return widget


class _Cell:
    """Where a widget is shown: passes on messages between its page and a shell."""

    def __init__(self, shell: PageShell, loop: asyncio.AbstractEventLoop):
        self._shell, self._loop = shell, loop
        self._running = loop.create_task(shell.run())
        self._session: PageSession | None = None
        self._sending: asyncio.Task[None] | None = None

    def receive(self, widget: AnyWidget, message: dict[str, Any], buffers: object) -> None:
        """Takes a message; a page that shows the widget, for the first time or again, says hello."""
        if message.get("type") != "hello":
            if self._session is not None:
                self._shell.receive(self._session, message)
            return
        if self._sending is not None:
            self._sending.cancel()

        async def send(message: dict[str, Any], picture: bytes) -> None:
            widget.send(message, [picture])

        self._session = self._shell.connect(send)
        self._sending = self._loop.create_task(self._session.run())
