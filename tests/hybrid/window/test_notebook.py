"""The window in a notebook: its widget, and what it says where it cannot be."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hybrid
from hybrid.window import viewer as module
from hybrid.window.learning import ShownScene
from tests.hybrid.window.fakes import Source

anywidget = pytest.importorskip("anywidget", reason="the window in a notebook needs anywidget")


@pytest.fixture
def source(monkeypatch) -> Source:
    """What is prepared."""
    source = Source()

    def prepared(scene: ShownScene, forest: Path | None, *more: object) -> Source:
        assert (scene, forest) == (ShownScene("box"), Path("box.forest"))
        return source

    monkeypatch.setattr(module, "prepared", prepared)
    return source


async def until(done: Callable[[], object]) -> None:
    async def wait() -> None:
        while not done():
            await asyncio.sleep(0.005)

    await asyncio.wait_for(wait(), 60)


def test_a_cell_shows_frames_and_its_events_count(source, monkeypatch, tmp_path):
    sent: list[tuple[dict[str, Any], list[bytes]]] = []
    monkeypatch.setattr(
        anywidget.AnyWidget, "send", lambda self, content, buffers=None: sent.append((content, buffers))
    )

    async def main() -> None:
        widget = hybrid.show("box", "box.forest", size=(320, 240), folder=tmp_path)

        def say(**message: object) -> None:
            widget._handle_custom_msg(message, [])

        def frames() -> list[int]:
            return [content["frame"]["number"] for content, _ in sent if "frame" in content]

        say(type="key_down", key="w", timestamp=0.0)
        say(type="hello")
        await until(frames)
        assert any(content.get("title") == "box - hybrid" for content, _ in sent)
        say(type="shown", frame=1, timestamp=1.0)
        say(type="pointer_move", x=80, y=120, timestamp=2.0)
        await until(lambda: source.requests[-1].settings.gaze.x == 0.25)
        # The cell is shown again.
        sent.clear()
        say(type="hello")
        # Frames are counted anew.
        await until(lambda: 1 in frames())
        assert any(buffers[0][:2] == b"\xff\xd8" for _, buffers in sent)
        # There is one window at a time.
        other = hybrid.show("box", "box.forest", size=(320, 240), folder=tmp_path)
        assert widget.comm is None
        other.close()
        other.close()

    asyncio.run(main())


def test_what_is_missing_is_said_in_one_line(monkeypatch):
    with pytest.raises(hybrid.UserError, match=r"^hybrid\.show: this is no notebook; run hybrid demo SCENE$"):
        hybrid.show("room")
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(hybrid.UserError, match=r"pip install 'foveated-hybrid-renderer\[notebook\]'$"):
        hybrid.show("room")
