"""What every way to make a frame gives in every view, and how good that is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compose.camera.camera import Camera
from hybrid.evaluation.entries import Entry
from hybrid.evaluation.judges import Picture, judged_in_parallel
from hybrid.evaluation.settings import EvaluationSettings
from hybrid.measure.metrics.installed import installed
from hybrid.measure.quality import Viewer
from hybrid.measure.reference import Reference
from hybrid.measure.regions import Region, regions
from hybrid.output.images import write_png
from hybrid.store.journal import Journal

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
    settings: EvaluationSettings,
    folder: Path,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Rows of view, method, budget, region, metric and value; the pictures are written into the folder.

    Args:
        entries: to be judged.
        views, references: on which.
        settings: gaze, radii, display and seed.
        folder: for pictures.
        journal: keeps the rows.
        progress: called with pictures judged and pictures in all.
    """
    viewer = Viewer(settings.frame.display, settings.frame.gaze)
    series = [
        _View(
            number, camera, truth, regions(settings.frame.foveation, truth.radiance), viewer, settings, folder
        )
        for number, (camera, truth) in enumerate(zip(views, references, strict=True))
    ]
    wanted = [(view, entry) for view in series for entry in (None, *entries)]
    missing = [(view, entry) for view, entry in wanted if view.title(entry) not in journal]
    pictures = ((view.title(entry), view.picture(entry)) for view, entry in missing)
    done = len(wanted) - len(missing)
    for number, (title, rows) in enumerate(judged_in_parallel(pictures)):
        journal[title] = rows
        progress(done + number + 1, len(wanted))
    return [row for view, entry in wanted for row in view.rows(entry, journal)]


@dataclass(frozen=True)
class _View:
    """One of the views that are measured. An entry of None stands for its reference."""

    number: int
    camera: Camera
    truth: Reference
    parts: dict[str, Region]
    viewer: Viewer
    settings: EvaluationSettings
    folder: Path

    def title(self, entry: Entry | None) -> str:
        """Under which the journal keeps what is said of a picture, by the metrics that are installed."""
        return ", ".join((str(self.number), HALVES if entry is None else entry.title, *installed()))

    def picture(self, entry: Entry | None) -> Picture:
        """Made, and its file written."""
        if entry is None:
            write_png(self.folder / picture_name(self.number, None), self.truth.radiance)
            return Picture(HALVES, *self.truth.halves, (), self.parts, self.viewer, None)
        image = entry.method.render(
            self.camera, self.settings.frame.gaze, self.settings.seed + self.number
        ).image
        write_png(self.folder / picture_name(self.number, _key(entry)), image)
        flip_file = self.folder / flip_name(self.number, _key(entry))
        truths = self.truth.radiance, self.truth.halves
        return Picture(entry.name, image, *truths, self.parts, self.viewer, flip_file)

    def rows(self, entry: Entry | None, journal: Journal) -> Iterator[dict[str, Any]]:
        """What the journal has of a picture."""
        method, budget = _key(entry)
        for row in journal[self.title(entry)]:
            yield {"view": self.number, "method": method, "budget": budget, **row}


def _key(entry: Entry | None) -> tuple[str, str]:
    return (HALVES, "fixed") if entry is None else (entry.name, entry.budget)
