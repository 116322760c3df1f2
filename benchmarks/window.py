"""Frame rate and latency of the window of Qt, in memory, and of the one in headless Chromium, in turns.

    python -m benchmarks.window SCENE [--forest FILE] [--seconds 20] [--repeats 3] [--json FILE]

Chromium must be installed, with its driver and selenium. In the browser, the page moves the mouse; latency is
from its event to the frame that the page is painted with, both on the page's clock.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import parser_of
from benchmarks.studies import chromium
from compose.base.files import json_text

_OPENED = "open "


def measure(words: list[str], browser: bool) -> dict[str, Any]:
    """Figures of `hybrid demo` with some words, with a browser where one is asked for.

    Raises:
        SystemExit: the command failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "window.json"
        command = [sys.executable, "-m", "hybrid.cli.main", "demo", *words]
        command += ["--out", folder, "--json", str(file), *(["--browser"] if browser else [])]
        environment = os.environ | {"QT_QPA_PLATFORM": "offscreen", "PYTHONUNBUFFERED": "1"}
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as demo:
            assert demo.stdout is not None
            if browser:
                address = next((line for line in demo.stdout if line.startswith(_OPENED)), "")
                with chromium() as page:
                    page.get(address.removeprefix(_OPENED).strip())
                    demo.wait()
            print(demo.stdout.read().strip())
        if demo.returncode:
            raise SystemExit(demo.returncode)
        found: dict[str, Any] = json.loads(file.read_text())
        # A screen's own rate rounds the median up or down, by as much as half of it.
        frames, taken = len(found["frames"]), sum(milliseconds for _, milliseconds in found["frames"])
        kept = {name: value for name, value in found.items() if name not in ("frames", "machine")}
        return kept | {"fps": 1000 * frames / taken}


def main() -> None:
    """Measures, prints the medians, and writes all figures."""
    parser = parser_of(__doc__)
    parser.add_argument("scene")
    parser.add_argument("--forest")
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    words = [given.scene, "--bench", str(given.seconds)]
    words += ["--forest", given.forest] if given.forest else []
    shells = {"qt": False, "browser": True}
    found: dict[str, list[dict[str, Any]]] = {shell: [] for shell in shells}
    for _ in range(given.repeats):
        for shell, browser in shells.items():
            found[shell].append(measure(words, browser))
    medians = {
        shell: {
            "fps": float(np.median([run["fps"] for run in runs])),
            "latency_ms": float(np.median([run["latency_ms"]["p50"] for run in runs])),
        }
        for shell, runs in found.items()
    }
    share = medians["browser"]["fps"] / medians["qt"]["fps"]
    for shell, figures in medians.items():
        print(f"{shell}: {figures['fps']:.1f} FPS, {figures['latency_ms']:.0f} ms from mouse to screen")
    print(f"the browser has {share:.0%} of the frames per second of Qt")
    if given.json:
        given.json.write_text(json_text({"medians": medians, "runs": found}))


if __name__ == "__main__":
    main()
