"""A folder with the results of an evaluation, without its having been run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from hybrid.evaluation.results import OURS, Results, flip_name, image_name
from hybrid.evaluation.verdicts import verdict_rows
from tests.hybrid.evaluation import fakes


def evaluation() -> dict[str, Any]:
    """The content of evaluation.json."""
    found = fakes.found()
    for row in found["time"]:
        row.update({"passes": {"trace": 0.7 * row["ms"]["p50"]}, "repeats": 20})
        row["ms"]["p95"] = 2 * row["ms"]["p50"]
        row["over_ours"] = row["ms"]["p50"] / 10
        row["over_ours_range"] = [0.9 * row["over_ours"], 1.1 * row["over_ours"]]
    preparation = [
        {"method": OURS, "seconds": 61.2, "frames_to_pay": 3060},
        {"method": "rmfr, tuned", "seconds": 0.0, "frames_to_pay": 0},
        {"method": "full", "seconds": None, "frames_to_pay": None},
    ]
    machine = {"cpu": "An <abacus>", "cores": 2, "python": "3.11", "packages": {"numpy": "1.26"}}
    return {**found, "preparation": preparation, "machine": machine, "verdicts": verdict_rows(found)}


def sweep(over: str = "radius") -> dict[str, Any]:
    """The content of sweep-*.json."""
    rows = [
        {
            **({"width": 48, "height": 32} if over == "resolution" else {"spp": 1, "radius": radius}),
            "ms": {"p50": 10.0 + radius},
            "full_ms": {"p50": 40.0},
            "ratio": 40 / (10 + radius),
            "repeats": 3,
            "covered": 0.1,
            "paper": {"ratio": 1.25},
            "quality": {"whole jod": 8.123, "foveal jod": 9.0, "foveal flip": 0.1},
        }
        for radius in (20, 90)
    ]
    crossing = {
        "width": 48,
        "height": 32,
        "radius": 50.0,
        "slower_from": None,
        "least_ratio": 0.4,
        "paper": 51.0,
    }
    return {
        "scene": "corner",
        "over": over,
        "title": "radius of the fovea",
        "fovea": "raw",
        "rows": rows,
        "break_even": [crossing] if over == "radius" else [],
    }


def write(folder: Path, flips: bool = True) -> dict[str, Any]:
    """Writes evaluation.json and all images; returns the content."""
    found = evaluation()
    (folder / "evaluation.json").write_text(json.dumps(found))
    for view in range(2):
        for number, key in enumerate([None, *Results(found).keys]):
            # Each image has a colour of its own.
            pixels = np.full((16, 32, 3), 20 * number + 10 * view, dtype=np.uint8)
            PillowImage.fromarray(pixels).save(folder / image_name(view, key))
            if key is not None and flips:
                PillowImage.fromarray(pixels).save(folder / flip_name(view, key))
    return found
