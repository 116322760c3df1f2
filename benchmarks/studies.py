"""How exactly studies show what they ask for, and how far their analysis can be trusted.

    python -m benchmarks.studies [VISION] [--json FILE]

VISION is the folder of public data about people's vision. Pictures are shown by Qt in memory, and by headless
Chromium, which must be installed, with its driver and selenium.
"""

from __future__ import annotations

import os
import queue
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import csv_rows, parser_of, report
from hybrid.render.image_files import write_srgb
from hybrid.study.browser import serve_study
from hybrid.study.comparisons import compare, holm, mean_votes
from hybrid.study.design import ANCHOR, REFERENCE, Clip, Design, StudyMethod, Timing, compared
from hybrid.study.observations import Choices, load_choices
from hybrid.study.scaling import scale
from hybrid.study.session import StudySession
from hybrid.study.simulated_observers import simulated_choices, simulated_ratings

_PAIRS, _WIDTH, _HEIGHT, _FPS = 5, 1280, 720, 30.0
_STUDIES = 1000
_OFF = ("background-networking", "component-update", "gpu", "quic", "sync")


def _study(folder: Path, frames: int) -> Design:
    """Five pairs with the timing of BT.500: a moving pattern with noise, which PNG hardly compresses."""
    shown = {
        f"scene {n}": [Clip(f"s{n}-{name}", name, frames, _FPS) for name in (REFERENCE, "test", ANCHOR)]
        for n in range(_PAIRS)
    }
    clips = tuple(clip for each in shown.values() for clip in each)
    comparisons = compared(StudyMethod.DSIS, shown, 0) | {"training": ()}
    design = Design("timing", StudyMethod.DSIS, Timing(), clips, size=(_WIDTH, _HEIGHT), **comparisons)
    noise = np.random.default_rng(0).integers(0, 24, (_HEIGHT, _WIDTH, 3), np.uint8)
    x, y = np.arange(_WIDTH), np.arange(_HEIGHT)[:, None]
    for number in range(frames):
        picture = np.uint8(100 + 100 * np.sin((x + y + 5 * number) / 40))[..., None] + noise
        for clip in clips:
            write_srgb(folder / "clips" / clip.name / f"{number:06}.png", picture)
    return design


def take_part_in_window(session: StudySession) -> None:
    """Takes part in a whole study in a window of Qt in memory, giving the first answer."""
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from PySide6.QtCore import QTimer
    from PySide6.QtTest import QTest
    from PySide6.QtWidgets import QApplication

    from hybrid.study.study_window import StudyWindow, run_study_window

    application = QApplication.instance() or QApplication([])

    def act() -> None:
        for window in application.topLevelWidgets():
            if isinstance(window, StudyWindow) and window.isVisible():
                if window.question_is_shown:
                    QTest.keyClicks(window.page, "5")
                elif window.button is not None:
                    window.button.click()

    timer = QTimer()
    timer.timeout.connect(act)
    timer.start(250)
    run_study_window(session)
    timer.stop()


@contextmanager
def chromium() -> Iterator[Any]:
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
    with chromium() as browser:
        browser.get(announced.get())
        while served.is_alive():
            # Seldom, so that asking takes no time from the page.
            served.join(0.25)
            for button in browser.find_elements("css selector", "#panel button:enabled")[:1]:
                button.click()


def _timing(canvas: Callable[[StudySession], None], frames: int) -> dict[str, Any]:
    """By how many intervals of the display phases were longer or shorter than asked, in all attempts."""
    with tempfile.TemporaryDirectory() as folder:
        session = StudySession(Path(folder), _study(Path(folder), frames), 1)
        canvas(session)
        session.close()
        rows = csv_rows(session.file)
    errors = np.array(
        [
            abs(float(shown) - float(asked)) / float(row["interval_ms"])
            for row in rows
            for asked, shown in (one.split(":") for one in row["phases"].split())
        ]
    )
    return {
        "trials": len(rows),
        "interval_ms": float(rows[0]["interval_ms"]),
        "median": float(np.median(errors)),
        "p99": float(np.percentile(errors, 99)),
        "most": float(errors.max()),
        "dropped": sum(int(row["dropped"]) for row in rows),
        "late": sum(int(row["late"]) for row in rows),
    }


_JODS = {"a": 10.0, "b": 9.5, "c": 9.0, "d": 8.0}
# Of each pair of a study: the true difference, its interval, and p, adjusted for the number of pairs.
_Pairs = list[tuple[float, float, float, float]]


def _coverage(differences: Callable[[dict[str, float], int], _Pairs]) -> dict[str, float]:
    """Shares of simulated studies: known differences within their intervals, and none that is called one."""
    inside = [
        [low <= true <= high for true, low, high, _ in differences(_JODS, seed)] for seed in range(_STUDIES)
    ]
    same = dict.fromkeys(_JODS, 10.0)
    wrong = [min(p for *_, p in differences(same, seed)) < 0.05 for seed in range(_STUDIES)]
    of_100 = np.array(inside).reshape(-1, 100, len(inside[0])).mean((1, 2))
    return {
        "studies": _STUDIES,
        "inside": float(np.mean(inside)),
        "least_of_100": float(of_100.min()),
        "most_of_100": float(of_100.max()),
        "false_differences": float(np.mean(wrong)),
    }


def _chosen(jods: dict[str, float], seed: int) -> _Pairs:
    """A study of 13 observers with three trials of each pair."""
    found = scale(simulated_choices({"": jods}, 13, 3, seed, lapse=0, spread=0.5))[0]
    names = found.conditions
    pairs = list(combinations(range(len(names)), 2))
    rows = [found.difference(*pair) for pair in pairs]
    return [
        (jods[names[a]] - jods[names[b]], row.low, row.high, p)
        for (a, b), row, p in zip(pairs, rows, holm([row.p for row in rows]), strict=True)
    ]


def _voted(jods: dict[str, float], seed: int) -> _Pairs:
    """A study of 15 observers with two votes on each condition of three scenes."""
    found = compare(mean_votes(simulated_ratings(dict.fromkeys("stu", jods), 15, 2, seed)))
    true = _mean_votes(tuple(jods.items()))
    return [
        (true[row["first"]] - true[row["second"]], row["low"], row["high"], row["p_holm"])
        for row in found["pairs"]
    ]


@cache
def _mean_votes(jods: tuple[tuple[str, float], ...]) -> dict[str, float]:
    """What very many observers vote, to which rounding and the scale's ends belong."""
    found = simulated_ratings({"": dict(jods)}, 50_000, 2, _STUDIES)
    return {name: float(found.vote[found.condition == name].mean()) for name, _ in jods}


def agreement_with_alsarr(vision: Path) -> dict[str, float]:
    """ALSaRR's choices (Jindal et al. 2021) scaled anew, against its published JND: r and rms."""
    columns = {
        "scene": "block+velocity_deg_s",
        "first": "texture_1+shading_rate_1",
        "second": "texture_2+shading_rate_2",
    }
    choices = load_choices(vision / "alsarr/pairwise.csv", columns)
    # At full rate, all textures are the reference.
    first, second = (
        np.where(np.char.endswith(names, " / 1"), "full", names) for names in (choices.first, choices.second)
    )
    told = first != second
    parts = (choices.observer, choices.group, first, second, choices.chosen_first)
    kept = Choices(*(part[told] for part in parts))
    scales = {found.group: found for found in scale(kept, reference="full")}
    ours, theirs = [], []
    for row in csv_rows(vision / "alsarr/jnd.csv"):
        found = scales[f"{row['block']} / {row['velocity_deg_s']}"]
        name = f"{row['texture']} / {float(row['shading_rate']):g}"
        ours.append(0.0 if name.endswith(" / 1") else float(found.jod[found.conditions.index(name)]))
        theirs.append(float(row["jnd"]))
    return _agreement(ours, theirs)


def agreement_with_hdr_vdc(vision: Path) -> dict[str, float]:
    """HDR-VDC's choices (Hammou et al. 2024) scaled anew, against its published JOD: r and rms."""
    kinds = ("compression", "height", "distance")
    columns = {"scene": "scene+luminance"} | {
        name: "+".join(f"{kind}_{n}" for kind in kinds) for n, name in enumerate(("first", "second"), 1)
    }
    rows = csv_rows(vision / "hdr_vdc/jod.csv")
    ours, theirs = [], []
    for found in scale(load_choices(vision / "hdr_vdc/pairwise.csv", columns)):
        here = [row for row in rows if f"{row['scene']} / {row['luminance']}" == found.group]
        jods = dict(zip(found.conditions, found.jod.tolist(), strict=True))
        names = [" / ".join(row[kind] for kind in kinds) for row in here]
        # The reference, at both distances, has 10 by definition.
        whole = [jods[name] for name, row in zip(names, here, strict=True) if row["reference"] == "1"]
        ours += [10 + jods[name] - float(np.mean(whole)) for name in names]
        theirs += [float(row["jod"]) for row in here]
    return _agreement(ours, theirs)


def _agreement(ours: list[float], theirs: list[float]) -> dict[str, float]:
    rms = float(np.sqrt(np.mean(np.subtract(ours, theirs) ** 2)))
    return {"conditions": len(ours), "r": float(np.corrcoef(ours, theirs)[0, 1]), "rms": rms}


def main() -> None:
    """Measures all of it, that against published scales if their data is there."""
    parser = parser_of(__doc__)
    parser.add_argument("vision", type=Path, nargs="?")
    options = parser.parse_args()
    canvases = {"window": take_part_in_window, "browser": take_part_in_browser}
    found: dict[str, Any] = {
        "timing": [
            {"canvas": name, "frames": frames, **_timing(canvas, frames)}
            for name, canvas in canvases.items()
            for frames in (1, 60)
        ],
        "coverage": {"choices": _coverage(_chosen), "votes": _coverage(_voted)},
    }
    if options.vision:
        scaled = {"alsarr": agreement_with_alsarr, "hdr_vdc": agreement_with_hdr_vdc}
        found["published"] = {name: agreement(options.vision) for name, agreement in scaled.items()}
    report(found, options.json)


if __name__ == "__main__":
    main()
