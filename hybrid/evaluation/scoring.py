"""Scores images in parallel processes, because metrics take longer than frames."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from compose.image.colour import Image
from hybrid.measure.frame_quality import Viewer, metric_rows
from hybrid.measure.image_metrics import ImageRegion
from hybrid.measure.perceptual_metrics import flip_map
from hybrid.render.image_files import write_srgb

# Rows of region, metric and value.
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class ScoringTask:
    """An image to score: the method that made it, and what it is compared with, (H, W, 3) linear radiance.

    The metrics are those that are wanted; the FLIP map goes to a file unless that is None.
    """

    method: str
    image: Image
    reference: Image
    regions: dict[str, ImageRegion]
    viewer: Viewer
    metrics: tuple[str, ...]
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
    compared = task.image, task.reference, task.regions, task.viewer
    return metric_rows(*compared, task.method, error, task.metrics)


@contextmanager
def scorers() -> Iterator[Callable[[Iterable[ScoringTask]], Iterator[Rows]]]:
    """A function that scores tasks, which it consumes a few ahead, and yields their rows in the same order.

    Its processes wait between calls, without taking any time.
    """
    workers = len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _start_worker)

    def scored(tasks: Iterable[ScoringTask]) -> Iterator[Rows]:
        waiting: deque[Future[Rows]] = deque()
        for task in tasks:
            with _program_left_alone():
                waiting.append(pool.submit(score, task))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        for one in waiting:
            yield one.result()

    try:
        yield scored
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
