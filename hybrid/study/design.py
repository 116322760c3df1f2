"""The design of a study: what is compared, how it is asked, and the order in which each observer sees it.

Three methods: the double-stimulus impairment scale of Rec. ITU-R BT.500 (DSIS, as in Foveated Path Culling's
study), graded single stimuli after a benchmark (as in Fov-GS's), and two-alternative forced choice (pairs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from enum import Enum
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import fastjsonschema
import numpy as np

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, read_json, write_text

FILE = "study.json"
# Conditions that the others are compared with, and that checks attention.
REFERENCE, ANCHOR = "reference", "anchor"
_FORMAT, _VERSION = "foveated study", 1
# Orders that are tried for one in which no scene follows itself.
_TRIES = 200
# Seconds in which an answer is expected.
_ANSWER = 3.0
# Ends of what a design may ask for.
_MOST_SECONDS, _MOST_COUNT, _MOST_TEXT, _MOST_SIDE = 3600.0, 10_000, 20_000, 16_384


class StudyMethod(Enum):
    """How observers judge."""

    DSIS = "dsis"
    GRADED = "graded"
    PAIRS = "pairs"


@dataclass(frozen=True)
class Timing:
    """Seconds of each phase of a trial, by default those of BT.500's DSIS, variant I.

    The cross before the first stimulus, the stimuli, the background between them; the answer counts from
    `least_answer` on, and has `answer` seconds (None: as long as it takes); `rest` is that of breaks.
    """

    fixation: float = 1.0
    stimulus: float = 2.0
    gap: float = 1.0
    answer: float | None = 11.0
    least_answer: float = 0.0
    rest: float = 30.0


@dataclass(frozen=True)
class Clip:
    """A stimulus: numbered PNG files in the folder of its name, shown at a rate per second.

    The marker is where the cross is drawn, in fractions of the frame: one place, or one for each frame.
    """

    name: str
    condition: str
    frames: int = 1
    fps: float = 30.0
    marker: tuple[tuple[float, float], ...] = ((0.5, 0.5),)


@dataclass(frozen=True)
class Comparison:
    """Clips that one trial shows, by name: reference and test (DSIS), one (graded), or two to choose from.

    Those of the same scene, which is a view of one, show the same. `expected` are the answers of an attentive
    observer where they are known: trials that check attention have them. With pairs, the answer is that of
    the order in which the clips stand here.
    """

    scene: str
    clips: tuple[str, ...]
    expected: tuple[int, ...] = ()


@dataclass(frozen=True)
class Trial:
    """One presentation to an observer: kind is training, attention or vote.

    `swapped` shows a pair in the other order; `benchmark`, of a graded study, shows a clip beforehand.
    """

    kind: str
    comparison: Comparison
    repeat: int = 0
    swapped: bool = False
    benchmark: str | None = None


# Values and labels; the last question of a pair is answered by position.
_IMPAIRMENT = (
    (5, "imperceptible"),
    (4, "perceptible, but not annoying"),
    (3, "slightly annoying"),
    (2, "annoying"),
    (1, "very annoying"),
)
_ARTIFACTS = ((5, "no artifacts"), (4, "hardly any"), (3, "some"), (2, "many"), (1, "obvious artifacts"))
_POSITIONS = ((1, "the first"), (2, "the second"))
SCALES = {
    StudyMethod.DSIS: ("How visible was the difference from the reference?", _IMPAIRMENT),
    StudyMethod.GRADED: ("How did it look, compared with the benchmark?", _ARTIFACTS),
    StudyMethod.PAIRS: ("Which looked better?", _POSITIONS),
}
_INSTRUCTIONS = {
    StudyMethod.DSIS: "You will see two pictures or videos, one after the other: the reference, then another "
    "one of the same scene.\n\nLook at the cross while they are shown, and keep your head still. Then say "
    "how visible the difference was, with a number key or a button.",
    StudyMethod.GRADED: "For each scene you will first see the benchmark, then several versions of it.\n\n"
    "Look at the cross while they are shown. After each version, say how it looked compared with the "
    "benchmark, with a number key or a button.",
    StudyMethod.PAIRS: "You will see two pictures or videos of the same scene, one after the other.\n\n"
    "Look at the cross while they are shown, and keep your head still. Then say which looked better, with "
    "key 1 or 2 or a button. If you are not sure, guess.",
}
_CONSENT = (
    "This study compares pictures and videos that a computer has rendered. Your answers and how long they "
    "took are stored under a number, and what the next page asks for, if anything.\n\nTaking part is "
    "voluntary: you may stop at any time, without a reason. If you feel unwell, stop and tell us."
)


@dataclass(frozen=True)
class Design:
    """A study as its file has it.

    Attributes:
        name, method, timing, clips, comparisons: what is shown, and how.
        training, attention: trials before those that count, and trials among them whose answers are known.
        benchmarks: of a graded study, the clip that is shown first, by scene.
        repeats: how often an observer judges each comparison.
        observers: how many are planned.
        between_breaks: trials between two breaks.
        size, background: of the clips in pixels, and of the screen around them in sRGB, 0 to 255.
        pixels_per_degree: of the display, at its centre.
        gaze: none; mouse or stream (Lab Streaming Layer), where the observer must look at the cross.
        tolerance: from the cross in degrees.
        consent, instructions, fields: shown, and asked for, at the beginning.
        seed: of all orders.

    Raises:
        ValueError: a clip is missing, or the design has nothing to compare.
    """

    name: str
    method: StudyMethod
    timing: Timing
    clips: tuple[Clip, ...]
    comparisons: tuple[Comparison, ...]
    training: tuple[Comparison, ...] = ()
    attention: tuple[Comparison, ...] = ()
    benchmarks: dict[str, str] = field(default_factory=dict)
    repeats: int = 1
    observers: int = 1
    between_breaks: int = 40
    size: tuple[int, int] = (1920, 1080)
    background: tuple[int, int, int] = (0, 0, 0)
    pixels_per_degree: float = 35.0
    gaze: str = "none"
    tolerance: float = 3.0
    consent: str = _CONSENT
    instructions: str = ""
    fields: tuple[dict[str, Any], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        names = {clip.name for clip in self.clips}
        if len(names) < len(self.clips):
            raise ValueError("two clips have the same name")
        count = 1 if self.method is StudyMethod.GRADED else 2
        compared = (*self.comparisons, *self.training, *self.attention)
        if any(len(one.clips) != count for one in compared):
            raise ValueError(f"a comparison of method {self.method.value} must have {count} clips")
        shown = {name for one in compared for name in one.clips} | set(self.benchmarks.values())
        if unknown := shown - names:
            raise ValueError(f"there is no clip {min(unknown)}")
        for clip in self.clips:
            if len(clip.marker) not in (0, 1, clip.frames):
                raise ValueError(f"clip {clip.name}: must have one marker, or one for each frame")
        if any(set(one.expected) - {value for value, _ in SCALES[self.method][1]} for one in self.attention):
            raise ValueError("attention: an expected answer is not one of the scale")

    def clip(self, name: str) -> Clip:
        """The clip of that name."""
        return next(clip for clip in self.clips if clip.name == name)

    @property
    def intro(self) -> str:
        """What observers are told, the design's own text or that of its method."""
        return self.instructions or _INSTRUCTIONS[self.method]

    def order(self, observer: int) -> list[Trial]:
        """The trials of an observer, numbered from 1; the same for the same seed and number."""
        rng = np.random.default_rng([self.seed, observer])
        if self.method is StudyMethod.GRADED:
            votes = list(self._graded(observer, rng))
        else:
            votes = list(self._compared(observer, rng))
        # Trials that check attention stand evenly among the others, neither first nor last.
        for number, at in enumerate(np.linspace(0, len(votes), len(self.attention) + 2)[-2:0:-1]):
            votes.insert(int(at), self._shown("attention", self.attention[-1 - number], rng))
        return [self._shown("training", one, rng) for one in self.training] + votes

    def _shown(self, kind: str, comparison: Comparison, rng: np.random.Generator) -> Trial:
        swapped = self.method is StudyMethod.PAIRS and bool(rng.integers(2))
        return Trial(kind, comparison, swapped=swapped, benchmark=self.benchmarks.get(comparison.scene))

    def _compared(self, observer: int, rng: np.random.Generator) -> Iterator[Trial]:
        """Rounds of all comparisons; over observers and rounds, each is shown in either order as often."""
        last = ""
        pairs = self.method is StudyMethod.PAIRS
        for repeat in range(self.repeats):
            scenes = [comparison.scene for comparison in self.comparisons]
            for number in _apart(scenes, last, rng):
                comparison = self.comparisons[number]
                yield Trial("vote", comparison, repeat, pairs and bool((observer + repeat + number) % 2))
                last = comparison.scene

    def _graded(self, observer: int, rng: np.random.Generator) -> Iterator[Trial]:
        """Scene by scene; the order of conditions is balanced over observers, carry-over included."""
        scenes = list(dict.fromkeys(one.scene for one in self.comparisons))
        for repeat in range(self.repeats):
            for number in rng.permutation(len(scenes)).tolist():
                own = [one for one in self.comparisons if one.scene == scenes[number]]
                rows = williams(len(own))
                row = rows[(observer * self.repeats + repeat + number) % len(rows)]
                for place, chosen in enumerate(row):
                    benchmark = self.benchmarks.get(scenes[number]) if place == 0 else None
                    yield Trial("vote", own[chosen], repeat, benchmark=benchmark)

    def phases(self, trial: Trial) -> list[dict[str, Any]]:
        """What a trial shows, before the question."""
        timing, names = self.timing, trial.comparison.clips
        clips = [self.clip(name) for name in (reversed(names) if trial.swapped else names)]
        labels = {StudyMethod.DSIS: ("Reference", ""), StudyMethod.PAIRS: ("1", "2")}.get(self.method, ("",))
        if trial.benchmark is not None:
            clips, labels = [self.clip(trial.benchmark), *clips], ("Benchmark", *labels)
        shown: list[dict[str, Any]] = []
        for clip, label in zip(clips, labels, strict=True):
            marker = [list(at) for at in clip.marker]
            plain = {"clip": None, "frames": 0, "fps": 1.0, "label": "", "marker": None}
            if shown:
                shown.append(plain | {"kind": "blank", "seconds": timing.gap})
            elif timing.fixation > 0:
                shown.append(plain | {"kind": "fixation", "seconds": timing.fixation, "marker": marker[:1]})
            # A video is shown whole.
            seconds = max(timing.stimulus, clip.frames / clip.fps)
            own = {"clip": clip.name, "frames": clip.frames, "fps": clip.fps, "label": label}
            shown.append({"kind": "clip", "seconds": seconds, "marker": marker, **own})
        return shown

    def minutes(self, observer: int) -> float:
        """About how long a session takes."""
        trials = self.order(observer)
        shown = sum(phase["seconds"] for trial in trials for phase in self.phases(trial))
        breaks = len(trials) // self.between_breaks * self.timing.rest
        return (shown + breaks + _ANSWER * len(trials)) / 60

    def save(self, folder: Path) -> None:
        """Writes study.json into a folder; UserError if it cannot be written, or could not be read again."""
        found = {"format": _FORMAT, "version": _VERSION, **asdict(self), "method": self.method.value}
        try:
            _schema()(found)
        except fastjsonschema.JsonSchemaException as error:
            raise UserError(f"{folder / FILE}: {one_line(error.message.removeprefix('data.'))}") from error
        write_text(folder / FILE, json_text(found))


def compared(method: StudyMethod, shown: dict[str, list[Clip]], attention: int) -> dict[str, Any]:
    """What a design compares, from the clips of each scene, of which one is the reference, one the anchor.

    DSIS compares each condition with the reference, pairs all with all. An anchor and the first
    comparisons are the training; `attention` trials show anchors.
    """
    votes: list[Comparison] = []
    anchors: list[Comparison] = []
    benchmarks = {}
    for scene, clips in shown.items():
        by_condition = {clip.condition: clip.name for clip in clips}
        anchor, truth = by_condition.pop(ANCHOR), by_condition[REFERENCE]
        if method is StudyMethod.PAIRS:
            votes += [Comparison(scene, pair) for pair in combinations(by_condition.values(), 2)]
            anchors.append(Comparison(scene, (truth, anchor), (1,)))
        elif method is StudyMethod.DSIS:
            votes += [Comparison(scene, (truth, name)) for name in by_condition.values() if name != truth]
            anchors.append(Comparison(scene, (truth, anchor), (1, 2)))
        else:
            votes += [Comparison(scene, (name,)) for name in by_condition.values()]
            anchors.append(Comparison(scene, (anchor,), (1, 2)))
            benchmarks[scene] = truth
    checks = tuple(anchors[number % len(anchors)] for number in range(attention))
    training = (replace(anchors[0], expected=()), *votes[:2])
    return {"comparisons": tuple(votes), "training": training, "attention": checks, "benchmarks": benchmarks}


def _apart(scenes: Sequence[str], before: str, rng: np.random.Generator) -> list[int]:
    """A random order in which, as far as possible, no scene follows itself (BT.500)."""
    best: list[int] = []
    fewest = len(scenes) + 1
    for _ in range(_TRIES):
        order = rng.permutation(len(scenes)).tolist()
        shown = [before, *(scenes[number] for number in order)]
        same = sum(one == other for one, other in pairwise(shown))
        if same < fewest:
            best, fewest = order, same
        if not same:
            break
    return best


@cache
def williams(count: int) -> tuple[tuple[int, ...], ...]:
    """Orders of `count` conditions in which each follows each other one as often (Williams 1949).

    As many orders as conditions, and twice as many for odd numbers.
    """
    first = [(place + 1) // 2 if place % 2 else -(place // 2) % count for place in range(count)]
    rows = [tuple((one + shift) % count for one in first) for shift in range(count)]
    return tuple(rows + [row[::-1] for row in rows] if count % 2 else rows)


def load_design(folder: Path) -> Design:
    """The design in a study's folder; UserError if there is none, or what is wrong with it in one line."""
    file = folder / FILE
    try:
        found = read_json(file)
        _schema()(found)
        return _design(found)
    except FileNotFoundError:
        raise UserError(f"{folder}: holds no study; make one with hybrid study design") from None
    except fastjsonschema.JsonSchemaException as error:
        raise UserError(f"{file}: {one_line(error.message.removeprefix('data.'))}") from error
    except (OSError, ValueError, UserError) as error:
        raise UserError(f"{file}: is damaged ({one_line(error)})") from error


def _design(found: dict[str, Any]) -> Design:

    def all_of(name: str) -> tuple[Comparison, ...]:
        return tuple(
            Comparison(one["scene"], tuple(one["clips"]), tuple(one.get("expected", ())))
            for one in found.get(name, ())
        )

    def clip(one: dict[str, Any]) -> Clip:
        places = tuple((float(x), float(y)) for x, y in one.get("marker", [(0.5, 0.5)]))
        return Clip(**{**one, "marker": places})

    values: dict[str, Any] = {one.name: found[one.name] for one in fields(Design) if one.name in found}
    values |= {name: tuple(found[name]) for name in ("size", "background", "fields") if name in found}
    values |= {name: all_of(name) for name in ("comparisons", "training", "attention")}
    values |= {"method": StudyMethod(found["method"]), "timing": Timing(**found["timing"])}
    return Design(**values | {"clips": tuple(map(clip, found["clips"]))})


@cache
def _schema() -> Callable[[object], object]:
    """The check of a design's JSON; names cannot lead out of the study's folder."""
    name = {"type": "string", "pattern": r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,199}$"}
    text = {"type": "string", "maxLength": _MOST_TEXT}
    seconds = {"type": "number", "minimum": 0, "maximum": _MOST_SECONDS}
    count = {"type": "integer", "minimum": 1, "maximum": _MOST_COUNT}
    fraction = {"type": "number", "minimum": 0, "maximum": 1}

    def items(of: dict[str, Any], least: int = 0, most: int = _MOST_COUNT) -> dict[str, Any]:
        return {"type": "array", "items": of, "minItems": least, "maxItems": most}

    def entry(required: dict[str, Any], **optional: object) -> dict[str, Any]:
        known = {"type": "object", "properties": required | optional, "additionalProperties": False}
        return known | {"required": list(required)}

    clip = entry(
        {"name": name, "condition": {"type": "string", "minLength": 1, "maxLength": 200}},
        frames=count,
        fps={"type": "number", "exclusiveMinimum": 0, "maximum": 1000},
        marker=items(items(fraction, 2, 2)),
    )
    scene = {"type": "string", "maxLength": 300}
    comparison = entry({"scene": scene, "clips": items(name, 1, 2)}, expected=items({"type": "integer"}))
    asked = entry(
        {"name": name, "label": text, "type": {"enum": ["text", "number", "choice"]}}, choices=items(text)
    )
    timing = {one.name: seconds for one in fields(Timing)}
    timing["answer"] = {"type": ["number", "null"], "exclusiveMinimum": 0, "maximum": _MOST_SECONDS}
    timing["stimulus"] = seconds | {"exclusiveMinimum": 0}
    wanted = entry(
        {
            "format": {"const": _FORMAT},
            "version": {"const": _VERSION},
            "name": {"type": "string", "maxLength": 300},
            "method": {"enum": [one.value for one in StudyMethod]},
            "timing": entry({}, **timing),
            "clips": items(clip, 1),
            "comparisons": items(comparison, 1),
        },
        training=items(comparison),
        attention=items(comparison),
        benchmarks={"type": "object", "additionalProperties": name},
        repeats=count,
        observers=count,
        between_breaks=count,
        size=items({"type": "integer", "minimum": 1, "maximum": _MOST_SIDE}, 2, 2),
        background=items({"type": "integer", "minimum": 0, "maximum": 255}, 3, 3),
        pixels_per_degree={"type": "number", "exclusiveMinimum": 0, "maximum": _MOST_COUNT},
        gaze={"enum": ["none", "mouse", "stream"]},
        tolerance={"type": "number", "exclusiveMinimum": 0, "maximum": 180},
        consent=text,
        instructions=text,
        fields=items(asked, 0, 50),
        seed={"type": "integer", "minimum": 0},
    )
    check: Callable[[object], object] = fastjsonschema.compile(wanted)
    return check
