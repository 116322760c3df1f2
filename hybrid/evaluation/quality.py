"""Quality of all methods in all views, and the images themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compose.camera.view import View
from hybrid.evaluation.entries import Entry
from hybrid.evaluation.files import flip_name, image_name
from hybrid.evaluation.keys import HALVES, HALVES_KEY
from hybrid.evaluation.scoring import ScoringTask, scored_in_parallel
from hybrid.evaluation.settings import EvaluationSettings
from hybrid.measure.metrics.installed import installed
from hybrid.measure.quality import Viewer
from hybrid.measure.reference import Reference
from hybrid.measure.regions import Region, regions
from hybrid.output.images import write_png
from hybrid.store.journal import Journal


@dataclass(frozen=True)
class EvaluatedView:
    """One of the evaluated views. An entry of None stands for its reference.

    Attributes:
        number: of the view, from 0.
        view: what it shows.
        reference: what frames are compared with.
        regions: of the frame, by name.
        settings: gaze, display and seed.
        folder: for images.
    """

    number: int
    view: View
    reference: Reference
    regions: dict[str, Region]
    settings: EvaluationSettings
    folder: Path

    def title(self, entry: Entry | None) -> str:
        """Name in the journal of an entry's rows, which depend on the installed metrics."""
        return ", ".join((str(self.number), HALVES if entry is None else entry.title, *installed()))

    def task(self, entry: Entry | None) -> ScoringTask:
        """Renders an entry's frame and writes it.

        Returns:
            What to score; of the reference, one half against the other.
        """
        viewer = Viewer(self.settings.frame.display, self.settings.frame.gaze)
        if entry is None:
            write_png(self.folder / image_name(self.number, None), self.reference.radiance)
            return ScoringTask(HALVES, *self.reference.halves, (), self.regions, viewer, None)
        image = entry.method.render(self.view, viewer.gaze, self.settings.seed + self.number).image
        write_png(self.folder / image_name(self.number, entry.key), image)
        flip_file = self.folder / flip_name(self.number, entry.key)
        references = self.reference.radiance, self.reference.halves
        return ScoringTask(entry.name, image, *references, self.regions, viewer, flip_file)

    def rows(self, entry: Entry | None, journal: Journal) -> Iterator[dict[str, Any]]:
        """An entry's rows in the journal, with view, method and budget."""
        key = HALVES_KEY if entry is None else entry.key
        for row in journal[self.title(entry)]:
            yield {"view": self.number, "method": key.method, "budget": key.budget, **row}


def evaluated_views(
    views: list[View], references: list[Reference], settings: EvaluationSettings, folder: Path
) -> list[EvaluatedView]:
    """Views with their references and regions.

    Raises:
        UserError: a region is empty.
    """
    return [
        EvaluatedView(
            number, view, truth, regions(settings.frame.foveation, truth.radiance), settings, folder
        )
        for number, (view, truth) in enumerate(zip(views, references, strict=True))
    ]


def quality_rows(
    entries: list[Entry],
    views: list[EvaluatedView],
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Rows of view, method, budget, region, metric and value; writes the images.

    Args:
        entries: to evaluate; references are evaluated as well.
        views: in which.
        journal: stores the rows; images whose rows it holds are not rendered again.
        progress: called with images scored and images in total.
    """
    wanted = [(view, entry) for view in views for entry in (None, *entries)]
    missing = [(view, entry) for view, entry in wanted if view.title(entry) not in journal]
    tasks = ((view.title(entry), view.task(entry)) for view, entry in missing)
    done = len(wanted) - len(missing)
    for number, (title, rows) in enumerate(scored_in_parallel(tasks)):
        journal[title] = rows
        progress(done + number + 1, len(wanted))
    return [row for view, entry in wanted for row in view.rows(entry, journal)]
