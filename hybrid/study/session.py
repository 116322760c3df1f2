"""One observer's session: what is shown next, what is stored of each answer, and how it resumes.

A session knows no toolkit: a canvas (Qt, browser, simulated observer) shows each step and replies to it. Of
an observer nothing is stored but a number, the answers with their timing, and what the design asks for.
"""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import json
import math
import os
import secrets
import time
from collections import deque
from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np

from compose.base.errors import UserError, one_line
from compose.base.files import json_text, require_size_below, write_text
from hybrid.study.design import SCALES, Design, StudyMethod, Trial

RESULTS = "results"
COLUMNS = (
    *("observer", "trial", "attempt", "kind", "scene", "repeat", "condition", "vote", "first", "second"),
    *("chosen", "correct", "problem", "reaction_ms", "interval_ms", "dropped", "late", "phases"),
)
# A trial that failed is shown again at the end, up to so often in all; the last time it counts anyway.
_ATTEMPTS = 3
# Display intervals by which a phase may be longer or shorter.
_INTERVALS = 2.0
# Share of the gaze that may be further from the cross than the design tolerates.
_MOST_OFF = 0.25
_MOST_BYTES, _MOST_TEXT = 1 << 26, 1_000
# Seconds for which a gaze stream is looked for, and of it that are kept: those of the longest trial.
_LOOKED_FOR, _KEPT = 5.0, 7200.0
Step = dict[str, Any]


class LabStream:
    """A stream of type Gaze, whose first two channels are x and y in fractions of the frame.

    UserError if pylsl is not installed, or there is no such stream.
    """

    def __init__(self, looked_for: float = _LOOKED_FOR):
        try:
            import pylsl
        except (ImportError, RuntimeError) as error:
            raise UserError(
                "a gaze stream needs pylsl: pip install 'foveated-hybrid-renderer[study]'"
            ) from error
        found = pylsl.resolve_byprop("type", "Gaze", 1, looked_for)
        if not found:
            raise UserError("gaze stream: there is none of type Gaze; start the eye tracker's first")
        if found[0].channel_count() < 2:
            raise UserError("gaze stream: needs two channels, x and y in fractions of the frame")
        # Times on this machine's clock.
        self._inlet = pylsl.StreamInlet(found[0], processing_flags=pylsl.proc_clocksync)
        self._now = pylsl.local_clock
        self._gazes: deque[tuple[float, float, float]] = deque()
        self._ended = Event()
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._ended.is_set():
            samples, times = self._inlet.pull_chunk(timeout=0.1)
            self._gazes.extend((at, one[0], one[1]) for one, at in zip(samples, times, strict=True))
            while self._gazes and self._gazes[0][0] < self._now() - _KEPT:
                self._gazes.popleft()
            if not samples:
                time.sleep(0.005)

    def last(self, seconds: float) -> list[tuple[float, float, float]]:
        """Gazes of the last seconds: seconds ago, x and y in fractions of the frame."""
        now = self._now()
        return [(now - at, x, y) for at, x, y in list(self._gazes) if at >= now - seconds]

    def close(self) -> None:
        """Ends the stream."""
        self._ended.set()
        self._thread.join()
        self._inlet.close_stream()


@dataclass(frozen=True)
class _Turn:
    """A trial whose turn comes: its number in the observer's order, from 1, and which attempt it is."""

    number: int
    trial: Trial
    attempt: int = 1


class StudySession:
    """The session of an observer, numbered from 1; it resumes where the observer's file ends.

    UserError if the file is damaged, belongs to another design, or is in use.
    """

    def __init__(self, folder: Path, design: Design, observer: int, stream: LabStream | None = None):
        self.folder, self._design, self._observer, self._stream = folder, design, observer, stream
        self.file = observer_file(folder, observer)
        self._queue = deque(_Turn(number, one) for number, one in enumerate(design.order(observer - 1), 1))
        self._votes = sum(turn.trial.kind == "vote" for turn in self._queue)
        self._resumed = self.file.exists()
        self._since_break = 0
        self._rows = self._opened()
        # Not from 0: a page that was open before a crash must not answer for the new session.
        self._ids = itertools.count(secrets.randbelow(1 << 32))
        self._flow = self._steps()
        self.step: Step = {"id": next(self._ids), **next(self._flow)}

    @property
    def done(self) -> bool:
        """Whether nothing is left to answer."""
        return self.step["kind"] == "end"

    def answer(self, reply: object) -> None:
        """Takes the reply to the current step; UserError, and no change, if it is not one."""
        if not isinstance(reply, dict) or reply.get("step") != self.step["id"]:
            raise UserError("reply: does not answer the current step")
        if self.done:
            return
        try:
            checked = _CHECKS.get(self.step["kind"], lambda step, reply: reply)(self.step, reply)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise UserError(f"reply: is not one to a {self.step['kind']} ({one_line(error)})") from error
        try:
            self.step = {"id": next(self._ids), **self._flow.send(checked)}
        except StopIteration as error:
            # After an answer that could not be stored.
            raise UserError(f"{self.file}: cannot be written any more; run the study again") from error

    def close(self) -> None:
        """Gives the observer's file back."""
        self._rows.close()

    def _steps(self) -> Generator[Step, dict[str, Any], None]:
        design = self._design
        if self._resumed:
            yield _text("Welcome back", "The study goes on where it ended.", "Continue")
        else:
            yield _text("Before we begin", design.consent, "I agree")
            if design.fields:
                reply = yield {
                    "kind": "form",
                    "title": "About you",
                    "fields": [{"choices": [], **one} for one in design.fields],
                    "button": "Continue",
                }
                write_text(self.file.with_suffix(".json"), json_text(reply["values"]))
            self._append(COLUMNS)
            yield _text("What to do", design.intro, "Begin")
        before = "training"
        while self._queue:
            turn = self._queue[0]
            if before == "training" != turn.trial.kind and design.training and not self._resumed:
                yield _text("That was the training", "From now on, your answers count.", "Begin")
            if self._since_break >= design.between_breaks:
                self._since_break = 0
                left = sum(turn.trial.kind != "training" for turn in self._queue)
                body = f"Rest your eyes for a while. {left} trials are left."
                yield _text("Break", body, "Continue", design.timing.rest)
            before = turn.trial.kind
            reply = yield self._trial(turn)
            self._take(turn, reply)
        yield {
            "kind": "end",
            "title": "Thank you",
            "body": "The study is complete. You may close this window.",
        }

    def _trial(self, turn: _Turn) -> Step:
        design = self._design
        question, scale = SCALES[design.method]
        count = self._votes - sum(one.trial.kind == "vote" for one in self._queue)
        return {
            "kind": "trial",
            "number": min(count + 1, self._votes),
            "of": self._votes,
            "phases": design.phases(turn.trial),
            "question": question,
            "answers": [{"value": value, "label": label, "key": str(value)} for value, label in scale],
            "seconds_to_answer": design.timing.answer,
            "least_seconds": design.timing.least_answer,
            "background": list(design.background),
            "size": list(design.size),
            "gaze": design.gaze,
        }

    def _take(self, turn: _Turn, reply: dict[str, Any]) -> None:
        """Stores the answer to a trial; one that failed is stored as such, and shown again later."""
        trial, answer, phases = turn.trial, reply["answer"], reply["phases"]
        problem = self._problem(trial, reply)
        # Training is over by then.
        again = bool(problem) and turn.attempt < _ATTEMPTS and trial.kind != "training"
        # Known of trials that check attention only.
        correct = ""
        if trial.kind == "attention":
            given = 3 - answer if trial.swapped and answer else answer
            correct = "yes" if given in trial.comparison.expected else "no"
        values: dict[str, Any] = self._identity(turn) | {
            "kind": "repeated" if again else trial.kind,
            "chosen" if self._design.method is StudyMethod.PAIRS else "vote": answer,
            "correct": correct,
            "problem": problem,
            "reaction_ms": round(reply["reaction_ms"], 1),
            "interval_ms": round(reply["interval_ms"], 2),
            "dropped": sum(one["dropped"] for one in phases),
            "late": sum(one["late"] for one in phases),
            "phases": " ".join(f"{one['asked_ms']:.0f}:{one['shown_ms']:.1f}" for one in phases),
        }
        self._append([values.get(name) for name in COLUMNS])
        self._passed(again)

    def _identity(self, turn: _Turn) -> dict[str, Any]:
        """What of a row the design and the observer's number already say."""
        trial, design = turn.trial, self._design
        names = trial.comparison.clips[::-1] if trial.swapped else trial.comparison.clips
        conditions = [design.clip(name).condition for name in names]
        pairs = design.method is StudyMethod.PAIRS
        shown = dict(zip(("first", "second"), conditions, strict=True)) if pairs else {}
        return shown | {
            "observer": self._observer,
            "trial": turn.number,
            "attempt": turn.attempt,
            "scene": trial.comparison.scene,
            "repeat": trial.repeat + 1,
            "condition": "" if pairs else conditions[-1],
        }

    def _passed(self, again: bool) -> None:
        turn = self._queue.popleft()
        self._since_break += 1
        if again:
            self._queue.append(replace(turn, attempt=turn.attempt + 1))

    def _problem(self, trial: Trial, reply: dict[str, Any]) -> str:
        """Why a trial is shown again; empty if it counts."""
        phases, most = reply["phases"], _INTERVALS * reply["interval_ms"]
        if reply["answer"] is None:
            return "no answer"
        for name in ("dropped", "late"):
            if any(one[name] for one in phases):
                return f"{name} frames"
        if any(abs(one["shown_ms"] - one["asked_ms"]) > most for one in phases):
            return "late phase"
        if self._design.gaze == "none":
            return ""
        gaze = reply["gaze"]
        if self._stream is not None:
            ago = (sum(one["shown_ms"] for one in phases) + reply["reaction_ms"]) / 1000
            gaze = [((ago - since) * 1000, x, y) for since, x, y in self._stream.last(ago)]
            if not gaze:
                return "no gaze"
        off = _off_the_cross(self._design, self._design.phases(trial), phases, gaze)
        return "looked away" if off > _MOST_OFF else ""

    def _append(self, values: Iterable[object]) -> None:
        """Adds a row, which is on the disk when this returns."""
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(values)
        try:
            self._rows.write(line.getvalue().encode())
            self._rows.flush()
            os.fsync(self._rows.fileno())
        except OSError as error:
            raise UserError(f"{self.file}: cannot be written ({error.strerror})") from error

    def _opened(self) -> io.BufferedRandom:
        """The observer's file, locked, and read as far as it goes."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            file = self.file.open("ab+")
        except OSError as error:
            raise UserError(f"{self.file}: cannot be written ({error.strerror})") from error
        try:
            _lock(file, self._observer)
            if self._resumed:
                self._replay(file)
        except BaseException:
            file.close()
            raise
        return file

    def _replay(self, file: io.BufferedRandom) -> None:
        """Passes the trials that have been answered; what a crash left of a line is removed."""
        try:
            require_size_below(self.file, _MOST_BYTES)
            file.seek(0)
            content = file.read()
            whole = content[: content.rfind(b"\n") + 1]
            rows = list(csv.reader(io.StringIO(whole.decode())))
        except (OSError, ValueError, csv.Error) as error:
            raise UserError(f"{self.file}: is damaged ({one_line(error)})") from error
        if rows and tuple(rows[0]) != COLUMNS:
            raise UserError(f"{self.file}: line 1: must be {','.join(COLUMNS)}")
        for number, row in enumerate(rows[1:], 2):
            found = dict(zip(COLUMNS, row, strict=False))
            if len(row) != len(COLUMNS) or not self._queue:
                raise UserError(f"{self.file}: line {number} is not an answer to a trial of this study")
            for name, value in self._identity(self._queue[0]).items():
                if found[name] != str(value):
                    was = one_line(f"{name} {found[name][:40]!r} where the design has {value!r}")
                    raise UserError(f"{self.file}: line {number}: {was}; its design was another one")
            self._passed(found["kind"] == "repeated")
        if len(whole) < len(content):
            file.truncate(len(whole))
        # Without its first line, it is that of an observer who has not begun.
        self._resumed = bool(rows)


def observer_file(folder: Path, observer: int) -> Path:
    """Where an observer's answers are."""
    return folder / RESULTS / f"observer-{observer:03}.csv"


def next_observer(folder: Path) -> int:
    """The number after the highest that has begun, from 1."""
    names = [file.stem.removeprefix("observer-") for file in (folder / RESULTS).glob("observer-*.csv")]
    return 1 + max((int(name) for name in names if name.isdecimal()), default=0)


def _lock(file: io.BufferedRandom, observer: int) -> None:
    """Keeps other processes from running the same observer, where the system can."""
    with contextlib.suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UserError(f"observer {observer}: is being run by another process") from error


def _text(title: str, body: str, button: str, seconds: float = 0.0) -> Step:
    return {"kind": "text", "title": title, "body": body, "button": button, "seconds": seconds}


def _off_the_cross(
    design: Design, asked: list[dict[str, Any]], shown: list[dict[str, Any]], gaze: list[Any]
) -> float:
    """Share of the gazes during clips that are further from the cross than tolerated; 0 without any."""
    start, off = 0.0, []
    for phase, took in zip(asked, shown, strict=True):
        end = start + took["shown_ms"]
        markers = (phase["marker"] if phase["kind"] == "clip" else None) or []
        for ms, x, y in gaze:
            if markers and start <= ms < end:
                at = markers[min(int((ms - start) / 1000 * phase["fps"]), len(markers) - 1)]
                pixels = math.hypot((x - at[0]) * design.size[0], (y - at[1]) * design.size[1])
                off.append(pixels / design.pixels_per_degree > design.tolerance)
        start = end
    return float(np.mean(off)) if off else 0.0


def _checked_form(step: Step, reply: dict[str, Any]) -> dict[str, Any]:
    values = {}
    for one in step["fields"]:
        value = str(reply["values"][one["name"]])[:_MOST_TEXT]
        if one["type"] == "number" and value:
            _finite(value)
        if one["type"] == "choice" and value not in ("", *one["choices"]):
            raise ValueError(f"{value[:40]!r} is not one of the choices")
        values[one["name"]] = value
    return {"values": values}


def _checked_trial(step: Step, reply: dict[str, Any]) -> dict[str, Any]:
    answer = reply["answer"]
    if answer not in (None, *(one["value"] for one in step["answers"])):
        raise ValueError("the answer is not one of the scale")
    phases = [
        {name: _finite(one[name]) for name in ("asked_ms", "shown_ms")}
        | {name: int(_finite(one[name])) for name in ("dropped", "late")}
        for one in reply["phases"]
    ]
    if len(phases) != len(step["phases"]):
        raise ValueError(f"{len(phases)} phases in place of {len(step['phases'])}")
    return {
        "answer": None if answer is None else int(answer),
        "phases": phases,
        "reaction_ms": _finite(reply["reaction_ms"]),
        "interval_ms": _finite(reply["interval_ms"]),
        "gaze": [[_finite(ms), float(x), float(y)] for ms, x, y in reply.get("gaze", ())],
    }


def _finite(value: str | float) -> float:
    number = float(value)
    if not 0 <= number < math.inf:
        raise ValueError(f"{json.dumps(value)[:40]} is not a number of 0 or more")
    return number


_CHECKS = {"form": _checked_form, "trial": _checked_trial}
