"""Simulated observers who take part in a study: they see what FovVideoVDP sees, and answer as people do.

They try a design, its files and its analysis before anyone comes, and tell how many observers it needs.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, write_whole
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, radiance_from_srgb
from hybrid.base.progress import Steps
from hybrid.measure.perceptual_metrics import INSTALL, jod_of_video
from hybrid.study.clips import CLIPS
from hybrid.study.design import Clip, Design, StudyMethod
from hybrid.study.session import StudySession
from hybrid.study.simulated_observers import chosen_share, noise, opinions, rounded_vote

_FILE = "jod.json"
# Frames of a video that are judged, from its middle: the metric keeps all of them in memory.
_MOST_FRAMES = 12
# Milliseconds of an answer, and of a display's interval.
_REACTION, _INTERVAL = 700.0, 1000 / 60


def clip_qualities(folder: Path, design: Design, display: Display, progress: Steps) -> dict[str, float]:
    """Quality in JOD of each clip that is compared, by name, against the first clip of its scene.

    Qualities that the folder has are not measured again. UserError if FovVideoVDP is not installed, it
    cannot judge the clips, or one is missing.
    """
    file = folder / CLIPS / _FILE
    truths: dict[str, str] = {}
    for one in (*design.comparisons, *design.attention, *design.training):
        truth = design.benchmarks.get(one.scene) or truths.get(one.clips[0]) or one.clips[0]
        truths |= {name: truths.get(name, truth) for name in one.clips}
    try:
        found: dict[str, float] = read_json(file) if file.exists() else {}
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: is damaged ({one_line(error)}); delete it") from error
    wanted = [name for name in truths if name not in found]
    for number, name in enumerate(wanted):
        progress(number, len(wanted))
        found[name] = _quality(folder, design.clip(name), design.clip(truths[name]), display)
        write_whole(file, partial(Path.write_text, data=json_text(found), encoding="utf-8"))
    progress(len(wanted), len(wanted))
    return found


def _quality(folder: Path, clip: Clip, truth: Clip, display: Display) -> float:
    """The mean of stills if the cross moves, because the metric's gaze rests; otherwise that of a video."""
    count = min(clip.frames, _MOST_FRAMES)
    moves = len(clip.marker) > 1
    first = 0 if moves else (clip.frames - count) // 2
    numbers = np.linspace(0, clip.frames - 1, count).astype(int) if moves else np.arange(first, first + count)
    images, expected = ([_frame(folder, one, n) for n in numbers] for one in (clip, truth))
    if moves:
        gazes = [Gaze(*clip.marker[n]) for n in numbers]
        parts = [
            jod_of_video([image], [other], 0.0, display, gaze)
            for image, other, gaze in zip(images, expected, gazes, strict=True)
        ]
    else:
        gaze = Gaze(*clip.marker[0]) if clip.marker else Gaze()
        parts = [jod_of_video(images, expected, clip.fps, display, gaze)]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        raise UserError(f"clip {clip.name}: cannot be judged; {INSTALL}")
    return float(np.mean(known))


def _frame(folder: Path, clip: Clip, number: int) -> Image:
    file = folder / CLIPS / clip.name / f"{number:06}.png"
    try:
        with PillowImage.open(file) as image:
            return radiance_from_srgb(np.asarray(image.convert("RGB"), np.float32) / 255)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: is missing or damaged; design the study again") from error


class SimulatedObserver:
    """An observer of a session, with qualities in JOD by clip; same seed and number, same answers."""

    def __init__(self, design: Design, jods: dict[str, float], observer: int, seed: int):
        self._design, self._jods = design, jods
        self._random = np.random.default_rng([seed, observer])
        conditions = sorted({clip.condition for clip in design.clips})
        self._own = dict(zip(conditions, opinions(self._random, len(conditions)), strict=True))

    def run(self, session: StudySession) -> None:
        """Answers all that is left of a session."""
        while not session.done:
            session.answer({"step": session.step["id"], **self._reply(session.step)})

    def _reply(self, step: dict[str, Any]) -> dict[str, Any]:
        if step["kind"] == "form":
            return {"values": {one["name"]: "" for one in step["fields"]}}
        if step["kind"] != "trial":
            return {}
        milliseconds = [1000 * one["seconds"] for one in step["phases"]]
        return {
            "answer": self._answer([one["clip"] for one in step["phases"] if one["clip"]]),
            "reaction_ms": _REACTION,
            "interval_ms": _INTERVAL,
            "phases": [{"asked_ms": ms, "shown_ms": ms, "dropped": 0, "late": 0} for ms in milliseconds],
            "gaze": [],
        }

    def _answer(self, clips: list[str]) -> int:
        if self._design.method is StudyMethod.PAIRS:
            first, second = (self._jods[name] for name in clips[-2:])
            return 1 if self._random.random() < chosen_share(first - second) else 2
        clip = self._design.clip(clips[-1])
        return int(rounded_vote(self._jods[clip.name], self._own[clip.condition] + noise(self._random)))
