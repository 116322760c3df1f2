"""A study whose steps are given, as canvases see it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compose.base.errors import UserError

END = {"kind": "end", "title": "Thank you", "body": "The study is over."}
ANSWERS = [{"value": value, "label": f"grade {value}", "key": str(value)} for value in range(1, 6)]


def text(**changes: Any) -> dict[str, Any]:
    return {
        "kind": "text",
        "title": "Welcome",
        "body": "One.\n\nTwo.",
        "button": "Begin",
        "seconds": 0,
    } | changes


def phase(clip: str | None, seconds: float = 0.1, frames: int = 1, fps: float = 60.0) -> dict[str, Any]:
    kind = "clip" if clip else "blank"
    times = {"seconds": seconds, "frames": frames, "fps": fps}
    return {"kind": kind, "clip": clip, "label": "", "marker": None} | times


def trial(*phases: dict[str, Any], size: tuple[int, int], **changes: Any) -> dict[str, Any]:
    step = {
        "kind": "trial",
        "number": 1,
        "of": 5,
        "phases": list(phases),
        "question": "How visible is the difference?",
        "answers": ANSWERS,
        "seconds_to_answer": None,
        "least_seconds": 0.0,
        "background": [90, 90, 90],
        "size": list(size),
    }
    return step | changes


class ScriptedSession:
    """Shows the given steps one after another and keeps the replies; the age in a form must be a number."""

    def __init__(self, folder: Path, *steps: dict[str, Any]):
        self.folder, self.steps, self.replies = folder, [*steps, END], []
        self.failure: Exception | None = None

    @property
    def step(self) -> dict[str, Any]:
        if self.failure:
            raise self.failure
        return {"id": len(self.replies), **self.steps[len(self.replies)]}

    def answer(self, reply: dict[str, Any]) -> None:
        if not reply.get("values", {"age": "1"})["age"].isdecimal():
            raise UserError("age: must be a number")
        self.replies.append(reply)
