"""What every way to make a frame gives in every view, and how good that is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.blend import Image
from compose.view import Camera, Display
from hybrid.evaluate.entries import Entry
from hybrid.evaluate.journal import Journal
from hybrid.evaluate.measure import Viewer, measured
from hybrid.evaluate.regions import regions
from hybrid.evaluate.settings import EvaluationSettings
from hybrid.images import write_bytes, write_png
from hybrid.metrics.flip import flip_map
from hybrid.reference import Reference

# The name under which the quality of a reference itself stands: one half of its samples against the other.
HALVES = "reference, half against half"


def picture_name(view: int, key: tuple[str, str] | None) -> str:
    """File name of a picture by a method and budget; that of the reference for none."""
    name = "reference" if key is None else "-".join(key)
    return f"{view}-{name}.png".replace(",", "").replace(" ", "-")


def flip_name(view: int, key: tuple[str, str]) -> str:
    """File name of the FLIP map of a picture."""
    return picture_name(view, key).replace(".png", "-flip.png")


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

        def compared(method: str, image: Image, truth: Image, error: Any = None, parts: Any = parts) -> Any:
            return measured(image, truth, parts, viewer, method, error)

        def made(entry: Entry, view: int = view, camera: Camera = camera, truth: Reference = truth) -> Any:
            image = entry.peer.make(camera, settings.gaze, settings.seed + view).image
            key = entry.method, entry.budget
            write_png(folder / picture_name(view, key), image)
            error = flip_map(image, truth.radiance)
            if error is not None:
                write_bytes(folder / flip_name(view, key), _coloured(error))
            return compared(entry.method, image, truth.radiance, error)

        write_png(folder / picture_name(view, None), truth.radiance)
        first, second = truth.halves
        found = journal.once(f"{view}, {HALVES}", partial(compared, HALVES, first, second))
        rows += [{"view": view, "method": HALVES, "budget": "fixed", **row} for row in found]
        for number, entry in enumerate(entries):
            found = journal.once(f"{view}, {entry.method}, {entry.budget}", partial(made, entry))
            rows += [{"view": view, "method": entry.method, "budget": entry.budget, **row} for row in found]
            progress(view * len(entries) + number + 1, len(views) * len(entries))
    return rows


def _coloured(error: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W, 3) a map of errors in 0..1, as FLIP's authors show them."""
    from matplotlib import colormaps

    return np.asarray(colormaps["magma"](error, bytes=True)[..., :3])
