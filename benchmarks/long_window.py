"""Memory, frame rate and latency of the window in headless Chromium over hours of people's recorded gaze.

    python -m benchmarks.long_window SCENE VISION [--forest FILE] [--hours 2] [--json FILE]

VISION is the folder of public data about people's vision, whose gaze traces follow each other, again and
again. Chromium must be installed, with its driver and selenium.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import csv_rows, parser_of, report
from benchmarks.studies import chromium

# Seconds between two looks, and until the window counts: by then, what is made once is made.
_EVERY, _SETTLE = 30.0, 120.0
_TIMES = re.compile(r"frame (\d+) ms.*?mouse to screen (\d+) ms", re.DOTALL)


def _joined(traces: list[Path], file: Path) -> None:
    """Writes gaze traces in degrees one after the other."""
    lines, begin = ["time_s,gaze_x_deg,gaze_y_deg"], 0.0
    for trace in traces:
        rows = csv_rows(trace)
        lines += [f"{begin + float(r['time_s']):.3f},{r['gaze_x_deg']},{r['gaze_y_deg']}" for r in rows]
        begin += float(rows[-1]["time_s"])
    file.write_text("\n".join(lines))


def _memory(process: int) -> float:
    """MiB of a process and all that it has started; what they share counts once."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name in parentheses may hold anything.
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    family = {process}
    while more := {one for one, parent in parents.items() if parent in family} - family:
        family |= more
    total = 0
    for one in family:
        try:
            lines = Path(f"/proc/{one}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total / 1024


def watched(words: list[str], vision: Path, seconds: float) -> list[dict[str, float]]:
    """Rows: seconds since the window settled, MiB of both ends, number of the frame, its ms and latency."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "gaze.csv"
        _joined(sorted((vision / "eyenavgs" / "gaze").glob("*.csv")), trace)
        command = [sys.executable, "-u", "-m", "hybrid.cli.main", "demo", *words, "--browser"]
        command += ["--gaze-trace", str(trace), "--out", folder]
        with (
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as demo,
            chromium() as page,
        ):
            assert demo.stdout is not None
            page.get(next(line for line in demo.stdout if line.startswith("open ")).split()[1])
            begin = time.monotonic() + _SETTLE
            while (now := time.monotonic()) < begin + seconds:
                time.sleep(min(_EVERY, begin + seconds - now))
                hud = page.find_element("css selector", ".hud").text
                number = page.find_element("css selector", ".canvas").get_attribute("data-frame")
                times = _TIMES.search(hud)
                if times is None:
                    raise SystemExit(f"the window shows no times: {hud!r}")
                row = {
                    "seconds": time.monotonic() - begin,
                    "window_mib": _memory(demo.pid),
                    "browser_mib": _memory(page.service.process.pid),
                    "frame": int(number),
                    "frame_ms": int(times[1]),
                    "latency_ms": int(times[2]),
                }
                print(row, file=sys.stderr, flush=True)
                if row["seconds"] >= 0:
                    rows.append(row)
            demo.terminate()
    return rows


def summed_up(rows: list[dict[str, float]]) -> dict[str, Any]:
    """Medians of the first and the last quarter, and how memory grows in the second half, in MiB per hour."""
    quarter = max(1, len(rows) // 4)
    found: dict[str, Any] = {
        "hours": rows[-1]["seconds"] / 3600,
        "frames": rows[-1]["frame"] - rows[0]["frame"],
    }
    for name in ("window_mib", "browser_mib", "frame_ms", "latency_ms"):
        values = np.array([row[name] for row in rows])
        first, last = (float(np.median(part)) for part in (values[:quarter], values[-quarter:]))
        found[name] = {"first": first, "last": last, "most": float(values.max())}
        if name.endswith("_mib"):
            late = rows[len(rows) // 2 :]
            hours = [row["seconds"] / 3600 for row in late]
            found[name]["per_hour"] = float(np.polyfit(hours, values[len(rows) // 2 :], 1)[0])
    return found


def main() -> None:
    """Measures, prints the summary, and writes all rows."""
    parser = parser_of(__doc__)
    parser.add_argument("scene")
    parser.add_argument("vision", type=Path)
    parser.add_argument("--forest")
    parser.add_argument("--hours", type=float, default=2.0)
    given = parser.parse_args()
    words = [given.scene, *(["--forest", given.forest] if given.forest else [])]
    rows = watched(words, given.vision, 3600 * given.hours)
    report({**summed_up(rows), "rows": rows}, given.json)


if __name__ == "__main__":
    main()
