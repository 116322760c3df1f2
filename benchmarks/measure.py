"""Measures the figures of the documentation again and keeps them as JSON; one machine, otherwise idle.

    python -m benchmarks.measure [--scenes FOLDER] [--vision FOLDER] [NAME ...]

What was measured by the same code on the same machine is not measured again, so that an interrupted run
resumes. `python -m benchmarks.tables` then writes the tables.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from benchmarks.hard_scenes import SCENES
from benchmarks.tables import BUDGETS, DATA, ROOT

# What stands for scene files of others, and where these lie.
OTHERS = {
    "STAIRCASE": "staircase2/scene.xml",
    "CLASSROOM": "classroom/scene.xml",
    "AJAR": "veach-ajar/scene.xml",
}
# What requires this forest requires `prepare-room`, which makes it.
_FRAMES = "--forest room.forest"
_PREPARED = "hybrid prepare {0}/scene.xml -o {0}.forest --held-out 4 --minutes 1 --seed 5"
# Scenes on which the placement of paths is compared, and their forests, which `prepare` makes.
_PLACED = {
    "room": ("room", "room"),
    "staircase2": ("STAIRCASE", "staircase2"),
    "room-moving": ("room-moving", "moving"),
    **{name: (f"{name}/scene.xml", name) for name in SCENES},
}
_PATHS = "hybrid sweep {0} --over paths --size 640 480 --repeats 9 --forest {1}.forest"
_LEVELS = {
    "fit": "hybrid levels {1}.forest -o {1}-levels.forest",
    "levels": "python -m benchmarks.levels {0} --forest {1}-levels.forest",
}
# Words of the commands whose JSON is kept: of `hybrid` or of a module of Python. Forests lie in the working
# folder, and so do the scenes of `benchmarks.hard_scenes`; VISION stands for the data about people's vision.
MEASUREMENTS = {
    "quickstart": "hybrid quickstart room --out out",
    "prepare-room": "hybrid prepare room -o room.forest --held-out 4 --minutes 1.5 --seed 5",
    "prepare-staircase2": "hybrid prepare STAIRCASE -o staircase2.forest --held-out 4 --minutes 1.5 --seed 5",
    "prepare-room-moving": "hybrid prepare room-moving -o moving.forest --held-out 4 --minutes 3 --seed 5",
    **{f"prepare-{name}": _PREPARED.format(name) for name in SCENES},
    **{
        f"budget-{seconds}": f"hybrid prepare room -o room-{seconds}.forest --held-out 4 "
        f"--minutes {seconds / 60:g} --seed 5"
        for seconds in BUDGETS
    },
    "frame": f"hybrid bench frame room {_FRAMES}",
    "resolution": f"hybrid sweep room --over resolution --repeats 9 {_FRAMES}",
    "radius": f"hybrid sweep room --over radius --repeats 5 {_FRAMES}",
    "denoiser": f"hybrid sweep room --over denoiser --size 512 512 {_FRAMES}",
    **{f"paths-{name}": _PATHS.format(*placed) for name, placed in _PLACED.items()},
    "evaluation": f"python -m benchmarks.evaluations room --quick {_FRAMES}",
    "periphery": f"hybrid bench periphery room {_FRAMES}",
    **{
        f"{kind}-{name}": command.format(*_PLACED[name])
        for name in ("room", "staircase2", "gantry", "workshop")
        for kind, command in _LEVELS.items()
    },
    "window": f"python -m benchmarks.window room --seconds 20 --repeats 3 {_FRAMES}",
    "late-warp": f"python -m benchmarks.late_warp room {_FRAMES}",
    "watching": "python -m benchmarks.watching room STAIRCASE CLASSROOM AJAR",
    "long-window": f"python -m benchmarks.long_window room VISION {_FRAMES}",
    "remote": f"python -m benchmarks.remote room --seconds 170 --hostile-seconds 600 {_FRAMES}",
    "integrator-room": "hybrid bench integrator room",
    "integrator-staircase2": "hybrid bench integrator STAIRCASE",
    "raster": "hybrid bench raster",
    "stored": f"python -m benchmarks.stored room {_FRAMES}",
    "acuity": "python -m benchmarks.fit_acuity VISION",
    "flicker": "python -m benchmarks.fit_flicker VISION",
    "gaze": f"hybrid bench gaze room {_FRAMES} --size 960 540 --latency 50 --gaze-error 0 --fps 72 "
    "--seconds 0.5 --clips 3",
    "studies": "python -m benchmarks.studies VISION",
}


def measure(name: str, work: Path, places: dict[str, Path]) -> None:
    """Runs a measurement in the working folder, and keeps its JSON with command, date, machine and code.

    The places are what words of commands stand for. CalledProcessError if the command failed.
    """
    from hybrid.base.identity import code, machine
    from pathtrace.scene.backend import select_backend

    select_backend()
    file = DATA / f"{name}.json"
    command = MEASUREMENTS[name]
    current = {"machine": machine(), "source": code()["source"]}
    if file.exists():
        known = json.loads(file.read_text())
        if all(known[key] == value for key, value in current.items()) and _has_forest(command, work):
            return
    if _FRAMES in command:
        measure("prepare-room", work, places)
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        program, *words = (str(places.get(word, word)) for word in command.split())
        if program == "hybrid":
            words = ["-m", "hybrid.cli.main", *words]
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, *words, "--json", str(result)],
            cwd=work,
            # What begins without a forest takes nothing prepared before, not even by another measurement;
            # compiled kernels are kept. The window needs no screen.
            env={
                **os.environ,
                "HYBRID_HOME": str(work / ("home" if "--forest" in command else f"home-{name}")),
                "QT_QPA_PLATFORM": "offscreen",
                "PYTHONPATH": str(ROOT),
            },
            check=True,
        )
        found: dict[str, Any] = {
            "command": " ".join(OTHERS.get(word, word) for word in command.split()),
            "date": datetime.now(timezone.utc).date().isoformat(),
            "seconds": round(time.perf_counter() - start, 1),
            **current,
            "result": json.loads(result.read_text()),
        }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(found, indent=1) + "\n")


def _has_forest(command: str, work: Path) -> bool:
    """Whether the forest that a measurement makes is still there for those that require it."""
    words = command.split()
    return "-o" not in words or (work / words[words.index("-o") + 1]).exists()


def main() -> None:
    """Measures what is named, or everything."""
    from hybrid.base.identity import code

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(MEASUREMENTS))
    parser.add_argument(
        "--scenes", type=Path, default=Path("../shared/scenes"), help="where others' scenes lie"
    )
    parser.add_argument("--vision", type=Path, default=Path("../shared/data"), help="data of people's vision")
    parser.add_argument("--work", type=Path, default=Path("out/measure"), help="working folder")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in MEASUREMENTS]
    if unknown:
        parser.error(f"{unknown[0]}: must be one of {', '.join(MEASUREMENTS)}")
    # What other code prepared is not gone on with.
    work = (options.work / code()["source"]).resolve()
    work.mkdir(parents=True, exist_ok=True)
    names = options.names or list(MEASUREMENTS)
    for scene, write in SCENES.items():
        if f"prepare-{scene}" in names:
            write(work / scene)
    places = {name: options.scenes.resolve() / file for name, file in OTHERS.items()}
    places["VISION"] = options.vision.resolve()
    for name in names:
        print(f"{name}: {MEASUREMENTS[name]}", flush=True)
        measure(name, work, places)


if __name__ == "__main__":
    main()
