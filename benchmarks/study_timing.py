"""How exactly studies show what they ask for: each phase's length in intervals of the display.

python -m benchmarks.study_timing [--frames COUNT ...]
"""

from __future__ import annotations

import argparse
import json
import queue
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hybrid.study.browser import StudySession, serve_study

_PAIRS = 5
_WIDTH, _HEIGHT = 1280, 720
# The order of a vote by ITU-R BT.500: a picture, grey, another picture, then the vote.
_SECONDS = (2.0, 1.0, 2.0)
_SCALE = ("very annoying", "annoying", "slightly annoying", "perceptible", "imperceptible")
_OFF = ("background-networking", "component-update", "gpu", "quic", "sync")


class PairSession:
    """A study of pairs, one after another, that keeps the replies in memory."""

    def __init__(self, folder: Path, frames: int):
        self.folder = folder
        self.replies: list[dict[str, Any]] = []
        phases = [
            {"kind": "clip", "seconds": _SECONDS[0], "clip": "reference", "frames": frames, "fps": 30.0},
            {"kind": "blank", "seconds": _SECONDS[1], "clip": None, "frames": 1, "fps": 60.0},
            {"kind": "clip", "seconds": _SECONDS[2], "clip": "test", "frames": frames, "fps": 30.0},
        ]
        answers = [{"value": k, "label": label, "key": str(k)} for k, label in enumerate(_SCALE, 1)]
        self._trial = {
            "kind": "trial",
            "of": _PAIRS,
            "phases": [{**phase, "label": "", "marker": None} for phase in phases],
            "question": "How do you rate the second picture?",
            "answers": answers,
            "seconds_to_answer": None,
            "least_seconds": 0.0,
            "background": [128, 128, 128],
            "size": [_WIDTH, _HEIGHT],
        }

    @property
    def step(self) -> dict[str, Any]:
        done = len(self.replies)
        if done == 0:
            return {"id": 0, "kind": "text", "title": "Study", "body": "", "button": "Begin", "seconds": 0}
        if done > _PAIRS:
            return {"id": done, "kind": "end", "title": "Thank you", "body": ""}
        return {"id": done, "number": done, **self._trial}

    def answer(self, reply: dict[str, Any]) -> None:
        self.replies.append(reply)


def write_clips(folder: Path, frames: int) -> None:
    """Clips `reference` and `test` of a study: a moving pattern with noise, which PNG hardly compresses."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 24, (_HEIGHT, _WIDTH, 3), np.uint8)
    x, y = np.arange(_WIDTH), np.arange(_HEIGHT)[:, None]
    for clip, slope in (("reference", 1), ("test", 2)):
        (folder / "clips" / clip).mkdir(parents=True)
        for number in range(frames):
            wave = 100 + 100 * np.sin((x + slope * y + 5 * number) / 40)
            picture = np.uint8(wave)[..., None] + noise
            Image.fromarray(picture).save(folder / "clips" / clip / f"{number:06d}.png", compress_level=1)


@contextmanager
def _chromium() -> Iterator[Any]:
    """A browser without a window and without habits of its own."""
    from selenium import webdriver

    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        raise SystemExit("chromium and chromedriver must be installed")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for option in ("headless", "no-sandbox", "no-first-run", "screen-info={1920x1080}"):
        options.add_argument(f"--{option}")
    for option in _OFF:
        options.add_argument(f"--disable-{option}")
    with tempfile.TemporaryDirectory() as profile:
        options.add_argument(f"--user-data-dir={profile}")
        browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
        try:
            yield browser
        finally:
            browser.quit()


def take_part_in_browser(session: StudySession) -> None:
    """Takes part in a whole study in headless Chromium, where the first button is always the one to press."""
    announced: queue.Queue[str] = queue.Queue()
    served = threading.Thread(target=serve_study, args=(session, announced.put), daemon=True)
    served.start()
    with _chromium() as browser:
        browser.get(announced.get())
        while served.is_alive():
            # Seldom, so that asking takes no time from the page.
            served.join(0.25)
            for button in browser.find_elements("css selector", "#panel button:enabled")[:1]:
                button.click()


def phase_errors(replies: list[dict[str, Any]]) -> dict[str, Any]:
    """By how many intervals of the display phases were longer or shorter than asked.

    Args:
        replies: to trials, as in `PairSession`.
    """
    found = [
        [abs(phase["shown_ms"] - phase["asked_ms"]) / reply["interval_ms"] for phase in reply["phases"]]
        for reply in replies
    ]
    phases = [phase for reply in replies for phase in reply["phases"]]
    return {
        "interval_ms": float(np.median([reply["interval_ms"] for reply in replies])),
        "median_of_each_phase": np.median(found, axis=0).round(3).tolist(),
        "p99_of_each_phase": np.percentile(found, 99, axis=0).round(3).tolist(),
        "median": float(np.median(found)),
        "p99": float(np.percentile(found, 99)),
        "dropped": sum(phase["dropped"] for phase in phases),
        "late": sum(phase["late"] for phase in phases),
    }


def measured(frames: int) -> dict[str, Any]:
    """Errors of the phases of a study of pairs of clips of so many frames, at 30 Hz."""
    with tempfile.TemporaryDirectory() as folder:
        write_clips(Path(folder), frames)
        session = PairSession(Path(folder), frames)
        take_part_in_browser(session)
    return phase_errors([reply for reply in session.replies if "phases" in reply])


def main() -> None:
    """Measures still pictures, and clips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[1, 60])
    print(json.dumps({frames: measured(frames) for frames in parser.parse_args().frames}, indent=1))


if __name__ == "__main__":
    main()
