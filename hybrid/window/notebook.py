"""The window in a cell of a Jupyter notebook: the same page, whose messages travel as those of a widget."""

from __future__ import annotations

import asyncio
import atexit
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window.learning import ShownScene
from hybrid.window.page import PageShell, asset
from hybrid.window.viewer import WindowOptions, viewer_of

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
_open: list[Any] = []


def show(
    scene: str | Path,
    forest: str | Path | None = None,
    settings: FrameSettings = INTERACTIVE,
    *,
    size: tuple[int, int] = (640, 480),
    target_fps: float | None = None,
    folder: str | Path = ".",
    backend: str = "auto",
) -> Any:
    """The window of `hybrid demo` for a notebook, which shows it where it is the value of a cell.

    The mouse is the gaze; F1 lists the keys. There is one window at a time: another one closes the one before.
    The scene is loaded, and rendered, on a thread of the kernel.

    Args:
        scene: name of a bundled scene, or path of a Mitsuba 3 XML file.
        forest: its forest file; if None, the newest forest of the scene, or one that is learnt while it is shown.
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
        import anywidget
    except ImportError as error:
        raise UserError("hybrid.show requires: pip install 'foveated-hybrid-renderer[notebook]'") from error
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError as error:
        raise UserError("hybrid.show: this is no notebook; run hybrid demo SCENE") from error

    class Window(anywidget.AnyWidget):  # type: ignore[misc, unused-ignore]
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

    for window in tuple(_open):
        window.close()
    options = WindowOptions(size, 0.0, Path(folder), target_fps)
    file = None if forest is None else Path(forest)
    viewer = viewer_of(ShownScene(str(scene), backend=backend), file, settings, None, options)
    shell, widget = PageShell(viewer), Window()
    _open.append(widget)
    # The renderer ends before Python does.
    atexit.register(widget.close)
    tasks = [loop.create_task(shell.run())]
    session = None

    async def send(message: dict[str, Any], picture: bytes) -> None:
        widget.send(message, [picture])

    def receive(widget: Any, message: dict[str, Any], buffers: list[bytes]) -> None:
        nonlocal session
        if message.get("type") == "hello":
            # A page that shows the cell, for the first time or again.
            for task in tasks[1:]:
                task.cancel()
            session = shell.connect(send)
            tasks[1:] = [loop.create_task(session.run())]
        elif session is not None:
            shell.receive(session, message)

    widget.on_msg(receive)
    return widget
