"""Small studies, with clips of single colours, and answers to them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hybrid.render.image_files import write_srgb
from hybrid.study.design import ANCHOR, REFERENCE, Clip, Design, StudyMethod, Timing, compared
from hybrid.study.session import StudySession

SIZE = 32, 24
QUICK = Timing(fixation=0.05, stimulus=0.1, gap=0.05, answer=None, rest=0.0)
CONDITIONS = REFERENCE, "hybrid", "splats"


def design(
    method: StudyMethod = StudyMethod.DSIS,
    scenes: int = 2,
    conditions: tuple[str, ...] = CONDITIONS,
    frames: int = 1,
    attention: int = 1,
    **settings: Any,
) -> Design:
    shown = {
        f"scene {n}": [Clip(f"s{n}-{name}", name, frames) for name in (*conditions, ANCHOR)]
        for n in range(scenes)
    }
    clips = tuple(clip for each in shown.values() for clip in each)
    made = compared(method, shown, attention)
    return Design("test", method, **{"timing": QUICK, "size": SIZE} | settings, clips=clips, **made)


def write_clips(folder: Path, made: Design) -> None:
    for number, clip in enumerate(made.clips):
        for frame in range(clip.frames):
            image = np.full((*SIZE[::-1], 3), 10 * number + frame, np.uint8)
            write_srgb(folder / "clips" / clip.name / f"{frame:06}.png", image)


def reply(session: StudySession, answer: int | None = 1, **changes: Any) -> dict[str, Any]:
    """A good reply to whatever is shown."""
    step = session.step
    found: dict[str, Any] = {"step": step["id"]}
    if step["kind"] == "form":
        found["values"] = {one["name"]: "" for one in step["fields"]}
    if step["kind"] == "trial":
        asked = [1000 * one["seconds"] for one in step["phases"]]
        phases = [{"asked_ms": ms, "shown_ms": ms, "dropped": 0, "late": 0} for ms in asked]
        found |= {"answer": answer, "reaction_ms": 500.0, "interval_ms": 16.7, "phases": phases, "gaze": []}
    return found | changes


def up_to_trials(session: StudySession) -> StudySession:
    """Passes what comes before the next trial."""
    while session.step["kind"] in ("text", "form"):
        session.answer(reply(session))
    return session


def finish(session: StudySession, answer: int = 1) -> list[dict[str, Any]]:
    """Answers all trials, and closes the session; returns what was shown."""
    shown = []
    while not up_to_trials(session).done:
        shown.append(session.step)
        session.answer(reply(session, answer))
    session.close()
    return shown
