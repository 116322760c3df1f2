"""What every way to make a frame gives in every view, and how good that is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from compose.blend import Image
from compose.view import Camera, Display
from hybrid.evaluate.entries import Entry
from hybrid.evaluate.journal import Journal
from hybrid.evaluate.measure import Viewer, measured
from hybrid.evaluate.regions import regions
from hybrid.evaluate.settings import EvaluationSettings
from hybrid.images import write_png
from hybrid.reference import Reference

# The name under which the quality of a reference itself stands: one half of its samples against the other.
HALVES = "reference, half against half"


def picture_name(view: int, entry: Entry | None) -> str:
    """File name of a picture; that of the reference for no entry."""
    if entry is None:
        return f"{view}-reference.png"
    return f"{view}-{entry.method}-{entry.budget}.png".replace(",", "").replace(" ", "-")


def judged(
    entries: list[Entry],
    views: list[Camera],
    references: list[Reference],
    display: Display,
    settings: EvaluationSettings,
    folder: Path,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Rows of view, method, budget, region, metric and value; the pictures are written into the folder.

    Args:
        entries: to be judged.
        views, references: on which.
        display: on which the frames are looked at.
        settings: gaze, radii and seed.
        folder: for pictures.
        journal: keeps the rows.
        progress: called with pictures judged and pictures in all.
    """
    viewer = Viewer(display, settings.gaze)
    rows: list[dict[str, Any]] = []
    for view, (camera, truth) in enumerate(zip(views, references, strict=True)):
        parts = regions(settings.foveation, truth.radiance)

        def compared(method: str, image: Image, truth: Image, parts: Any = parts) -> Any:
            return measured(image, truth, parts, viewer, method)

        def made(entry: Entry, view: int = view, camera: Camera = camera, truth: Reference = truth) -> Any:
            image = entry.peer.make(camera, settings.gaze, settings.seed + view).image
            write_png(folder / picture_name(view, entry), image)
            return compared(entry.method, image, truth.radiance)

        write_png(folder / picture_name(view, None), truth.radiance)
        first, second = truth.halves
        found = journal.once(f"{view}, {HALVES}", partial(compared, HALVES, first, second))
        rows += [{"view": view, "method": HALVES, "budget": "fixed", **row} for row in found]
        for number, entry in enumerate(entries):
            found = journal.once(f"{view}, {entry.method}, {entry.budget}", partial(made, entry))
            rows += [{"view": view, "method": entry.method, "budget": entry.budget, **row} for row in found]
            progress(view * len(entries) + number + 1, len(views) * len(entries))
    return rows
