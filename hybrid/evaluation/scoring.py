"""Scores images in parallel processes, because metrics take longer than frames."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.image.colour import Image
from hybrid.evaluation.results import half_name
from hybrid.measure.frame_quality import Viewer, metric_rows, tie_metrics
from hybrid.measure.image_metrics import ImageRegion
from hybrid.measure.perceptual_metrics import flip_map
from hybrid.render.image_files import write_srgb

# Rows of region, metric and value.
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class ScoringTask:
    """An image to score: the method that made it, and what it is compared with, (H, W, 3) linear radiance.

    It is compared with the reference's halves as well. The FLIP map goes to a file unless that is None.
    """

    method: str
    image: Image
    reference: Image
    halves: tuple[Image, ...]
    regions: dict[str, ImageRegion]
    viewer: Viewer
    flip_file: Path | None


def score(task: ScoringTask) -> Rows:
    """Rows of region, metric and value; writes the FLIP map. UserError if images cannot be compared."""
    error = None
    if task.flip_file is not None:
        error = flip_map(task.image, task.reference, task.viewer.display.pixels_per_degree)
        if error is not None:
            from matplotlib import colormaps

            # The colours of FLIP's authors.
            write_srgb(task.flip_file, np.asarray(colormaps["magma"](error, bytes=True)[..., :3]))
    rows: Rows = metric_rows(task.image, task.reference, task.regions, task.viewer, task.method, error)
    for number, half in enumerate(task.halves, 1):
        for row in tie_metrics(task.image, half, task.regions, task.viewer):
            rows.append({**row, "metric": half_name(str(row["metric"]), number)})
    return rows


def scored_in_parallel(tasks: Iterator[tuple[str, ScoringTask]]) -> Iterator[tuple[str, Rows]]:
    """Names of tasks, which are consumed a few ahead, and the results of `score`, in the same order."""
    workers = len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker)
    waiting: deque[tuple[str, Future[Rows]]] = deque()
    try:
        for name, task in tasks:
            with _program_left_alone():
                waiting.append((name, pool.submit(score, task)))
            if len(waiting) > 2 * workers:
                name, rows = waiting.popleft()
                yield name, rows.result()
        for name, rows in waiting:
            yield name, rows.result()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _program_left_alone() -> Iterator[None]:
    """New processes do not run the user's program again: it may come from the standard input."""
    main = vars(sys.modules["__main__"])
    kept: dict[str, Any] = {name: main[name] for name in ("__file__", "__spec__") if name in main}
    main.pop("__file__", None)
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(kept)


def _start_worker() -> None:
    """Workers ignore SIGINT, which the parent handles, and end with it; each uses one core."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Ends this worker when its parent is killed: it would wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
