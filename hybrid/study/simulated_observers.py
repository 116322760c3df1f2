"""Simulated observers, who see what FovVideoVDP sees, or given qualities in JOD, and answer as people do.

They try a design, its files and its analysis before anyone comes, and tell how many observers it needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line, require_seed
from compose.base.files import json_text, read_json, write_text
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, radiance_from_srgb
from hybrid.base.progress import Steps
from hybrid.measure.perceptual_metrics import INSTALL, jod_of_video
from hybrid.study.clips import CLIPS
from hybrid.study.design import Clip, Design, StudyMethod
from hybrid.study.observations import Choices, Ratings
from hybrid.study.scaling import SIGMA, Quality, preference
from hybrid.study.session import StudySession

_FILE = "jod.json"
# Frames of a video that are judged, from its middle: the metric keeps all of them in memory.
_MOST_FRAMES = 12
# Milliseconds of an answer, and of a display's interval.
_REACTION, _INTERVAL = 700.0, 1000 / 60
# Share of the trials in which an observer presses any button; steps of a scale per JOD; standard deviations,
# in steps, of observers' biases and opinions, and from vote to vote. All are made up; with them, a single
# vote has a standard deviation of some .8, as in FPC's study (.88).
_LAPSE, _SLOPE, _SPREAD, _NOISE = 0.02, 0.6, 0.4, 0.6
# Qualities in JOD by condition, by scene.
Qualities = Mapping[str, Mapping[str, float]]


def chosen_share(jod: Quality, lapse: float = _LAPSE) -> Quality:
    """Probability that what is better by some JOD is chosen, with lapses."""
    return lapse / 2 + (1 - lapse) * preference(jod)


def rounded_vote(jod: float, own: Quality) -> Quality:
    """The vote from 1 to 5 on a quality, with an observer's own opinion and noise in steps."""
    found: Quality = np.clip(np.rint(5 - _SLOPE * (10 - jod) + own), 1, 5)
    return found


def simulated_choices(
    jods: Qualities,
    observers: int,
    repetitions: int = 1,
    seed: int = 0,
    lapse: float = _LAPSE,
    spread: float = 0.0,
) -> Choices:
    """Choices between all pairs of the conditions of each scene, by Thurstone's case V (1 JOD is 75 %).

    Args:
        jods: qualities in JOD, by condition, by scene.
        observers: how many.
        repetitions: trials of each pair.
        seed: of the random numbers.
        lapse: share of the trials in which an observer presses any button.
        spread: standard deviation in JOD of observers' own qualities of a condition; all observers together
            still prefer as the given qualities say.
    """
    random = np.random.default_rng(require_seed(seed))
    rows, chosen = [], []
    for scene, qualities in jods.items():
        # Over observers, the difference of two qualities has the variance of both on top.
        widened = np.array(list(qualities.values())) * np.sqrt(1 + 2 * (spread / SIGMA) ** 2)
        own = widened + random.normal(0, spread, (observers, len(qualities)))
        names = list(qualities)
        for first, second in combinations(range(len(names)), 2):
            prefers = chosen_share(own[:, first] - own[:, second], lapse)
            # Each is shown first as often as the other, up to one.
            swapped = (np.arange(repetitions) + random.integers(2, size=(observers, 1))) % 2 == 1
            better = random.random((observers, repetitions)) < prefers[:, None]
            order = np.where(swapped[..., None], [second, first], [first, second]).reshape(-1, 2)
            rows.append(_rows(observers, repetitions, scene, np.array(names)[order].T))
            chosen.append((better ^ swapped).ravel())
    observer, group, first_shown, second_shown = (np.concatenate(part) for part in zip(*rows, strict=True))
    return Choices(observer, group, first_shown, second_shown, np.concatenate(chosen))


def simulated_ratings(jods: Qualities, observers: int, repetitions: int = 1, seed: int = 0) -> Ratings:
    """Votes from 1 to 5 for every condition of each scene; 10 JOD is what cannot be told from the reference.

    A vote is 5 - .6 (10 - JOD) + the observer's bias and own opinion of the condition + noise, rounded to the
    nearest step, and kept on the scale. Arguments are as for `simulated_choices`.
    """
    random = np.random.default_rng(require_seed(seed))
    bias = random.normal(0, _SPREAD, (observers, 1))
    conditions = dict.fromkeys(name for qualities in jods.values() for name in qualities)
    # An observer's opinion of a condition is the same in all scenes.
    own = {name: bias + random.normal(0, _SPREAD, (observers, 1)) for name in conditions}
    rows, votes = [], []
    for scene, qualities in jods.items():
        for name, jod in qualities.items():
            vote = rounded_vote(jod, own[name] + random.normal(0, _NOISE, (observers, repetitions)))
            rows.append(_rows(observers, repetitions, scene, np.full((1, observers * repetitions), name)))
            votes.append(vote.ravel())
    observer, where, condition = (np.concatenate(part) for part in zip(*rows, strict=True))
    return Ratings(observer, where, condition, np.concatenate(votes))


def _rows(observers: int, repetitions: int, scene: str, names: NDArray[np.str_]) -> list[NDArray[np.str_]]:
    """Columns of an observer's name, the scene, and the given ones."""
    digits = len(str(observers))
    people = np.repeat([f"O{n:0{digits}}" for n in range(1, observers + 1)], repetitions)
    return [people, np.full(len(people), scene), *names]


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
        write_text(file, json_text(found))
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
        # Opinions of conditions, bias included, in steps.
        own = self._random.normal(0, _SPREAD) + self._random.normal(0, _SPREAD, len(conditions))
        self._own = dict(zip(conditions, own.tolist(), strict=True))

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
        own = self._own[clip.condition] + float(self._random.normal(0, _NOISE))
        return int(rounded_vote(self._jods[clip.name], own))
