"""Prepares and evaluates several scenes, one after the other, and says what is ahead of what.

    python -m benchmarks.evaluations [--quick] [--json FILE] [SCENE ...]

Without names, the six of SCENES; a name may also be a scene file. Whatever was interrupted goes on where it
was, and what is complete is read again. With --quick, one scene and baselines at equal time only: fewer rows,
of as many samples. Frames are small, so that all six take hours, not days, on two cores.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks import hard_scenes
from benchmarks.tables import EVALUATED, ROOT

# What is evaluated, and how: no denoiser touches the references of one of them.
SCENES = {
    "room": [],
    "cornell": ["--raw-references"],
    "meadow": [],
    "room-moving": [],
    "grove": [],
    "workshop": [],
}
_PREPARE = ["--minutes", "1.5", "--held-out", "0", "--seed", "5"]
_EVALUATE = ["--size", "320", "240"]


def evaluated(scene: str, work: Path, forest: Path | None, quick: bool) -> dict[str, Any]:
    """Prepares a scene unless there is a forest, and evaluates it in a folder; what `kept` keeps."""
    name = Path(scene).parent.name if scene.endswith(".xml") else scene
    file = scene
    if scene in hard_scenes.SCENES:
        hard_scenes.SCENES[scene](work / scene)
        file = str(work / scene / "scene.xml")
    if forest is None:
        forest = work / f"{name}.forest"
        if not forest.exists():
            _hybrid("prepare", file, "-o", forest, *_PREPARE)
    report = work / f"{name}{'-quick' if quick else ''}"
    options = [*_EVALUATE, *SCENES.get(scene, []), *(["--quick"] if quick else [])]
    if not (report / "evaluation.json").exists():
        _hybrid("evaluate", file, "--forest", forest, "--report", report, *options)
    return kept(json.loads((report / "evaluation.json").read_text()))


def _hybrid(*words: object) -> None:
    command = [sys.executable, "-m", "hybrid.cli.main", *map(str, words)]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)})


def kept(found: dict[str, Any]) -> dict[str, Any]:
    """Of evaluation.json what tables show: verdicts, and times and means over the views of each method."""
    from hybrid.evaluation.results import Results
    from hybrid.evaluation.verdicts import display_name, sentences

    results = Results(found)
    affordable = results.affordable_baselines()
    methods = []
    for key in results.keys:
        means = {name: results.mean(key, *name.split()) for name in EVALUATED}
        row = next(row for row in found["time"] if (row["method"], row["budget"]) == key)
        times = {name: row[name] for name in ("ms", "over_ours", "over_ours_range")}
        about = {"label": results.label(key), "affordable": key in affordable}
        methods.append(key._asdict() | about | times | {"means": means})
    return {
        "scene": found["scene"],
        "display": display_name(found),
        "views": len(results.views_of("near")),
        "settings": found["settings"],
        "machine": found["machine"],
        "sentences": sentences(found),
        "methods": methods,
        "preparation": found["preparation"],
        "verdicts": [row for row in found["verdicts"] if row["region"] != "peripheral"],
    }


def main() -> None:
    """Evaluates what is named, or everything."""
    import hybrid  # noqa: F401  # before torch
    from hybrid.base.identity import code
    from pathtrace.scene.backend import select_backend

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--quick", action="store_true", help="one scene, baselines at equal time only")
    parser.add_argument("--forest", type=Path, help="forest of a single scene; without it, one is prepared")
    parser.add_argument("--work", type=Path, default=Path("out/evaluations"), help="working folder")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the result")
    options = parser.parse_args()
    names = options.scenes or list(SCENES)[: 1 if options.quick else None]
    if options.forest is not None and len(names) != 1:
        parser.error("--forest: is that of a single scene")
    select_backend()
    work = (options.work / code()["source"]).resolve()
    work.mkdir(parents=True, exist_ok=True)
    found, start = [], time.perf_counter()
    for number, name in enumerate(names, 1):
        print(f"scene {number} of {len(names)}: {name}", flush=True)
        forest = options.forest and options.forest.resolve()
        found.append(evaluated(name, work, forest, options.quick))
        seconds = time.perf_counter() - start
        left = seconds / number * (len(names) - number)
        print(f"{seconds / 60:.0f} minutes, about {left / 60:.0f} left", flush=True)
    for one in found:
        print("\n".join(one["sentences"]))
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
