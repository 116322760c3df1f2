"""Pictures judged beside each other, in processes of their own: metrics take longer than frames."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from compose.image.colour import Image
from hybrid.measure.metrics.flip import flip_map
from hybrid.measure.quality import Viewer, foveal, half_name, measured
from hybrid.measure.regions import Region
from hybrid.output.images import write_srgb


@dataclass(frozen=True)
class Picture:
    """A picture to be judged.

    Attributes:
        method: that made it.
        image, truth: (H, W, 3) linear radiance, and what it should be.
        halves: of the reference, which the fovea is compared with as well.
        regions: of the frame.
        viewer: who looks.
        flip_file: where the map of its FLIP goes, None for nowhere.
    """

    method: str
    image: Image
    truth: Image
    halves: tuple[Image, ...]
    regions: dict[str, Region]
    viewer: Viewer
    flip_file: Path | None


def judge(picture: Picture) -> list[dict[str, Any]]:
    """Rows of region, metric and value.

    Raises:
        UserError: the picture cannot be compared.
    """
    error = None
    if picture.flip_file is not None:
        error = flip_map(picture.image, picture.truth)
        if error is not None:
            write_srgb(picture.flip_file, _coloured(error))
    parts, viewer = picture.regions, picture.viewer
    rows = measured(picture.image, picture.truth, parts, viewer, picture.method, error)
    for number, half in enumerate(picture.halves, 1):
        for metric, value in foveal(picture.image, half, parts["foveal"], viewer).items():
            rows.append({"region": "foveal", "metric": half_name(metric, number), "value": value})
    return rows


def judged_in_parallel(pictures: Iterator[tuple[str, Picture]]) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Names and what `judge` says, in the order in which the pictures come.

    Args:
        pictures: with their names; made one after the other, a few ahead of those that are judged.
    """
    workers = len(os.sched_getaffinity(0))
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin)
    waiting: deque[tuple[str, Future[list[dict[str, Any]]]]] = deque()
    try:
        for name, picture in pictures:
            waiting.append((name, pool.submit(judge, picture)))
            if len(waiting) > 2 * workers:
                name, judgement = waiting.popleft()
                yield name, judgement.result()
        for name, judgement in waiting:
            yield name, judgement.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """An interruption is the parent's business; each process has one core."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


def _coloured(error: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W, 3) a map of errors in 0..1, as FLIP's authors show them."""
    from matplotlib import colormaps

    return np.asarray(colormaps["magma"](error, bytes=True)[..., :3])
