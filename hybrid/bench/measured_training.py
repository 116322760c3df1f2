"""Trainings in processes of their own, which tell their time and their memory."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import dataclass
from pathlib import Path

from compose.base.arrays import BackendName
from splat.io.precision import Precision
from splat.training.trainer import TrainingSettings


@dataclass(frozen=True)
class MeasuredTraining:
    """What the steps of a training took; the fusion, which is fitted after them, is left out.

    Attributes:
        seconds: of all steps.
        peak_bytes: most memory of the process, beyond what it had before.
    """

    seconds: float
    peak_bytes: int


def measured_training(
    frames: Path, path: Path | None, settings: TrainingSettings, backend: BackendName
) -> MeasuredTraining:
    """Trains a forest on a frame set.

    Args:
        frames: folder of the frame set.
        path: forest file to write, with exact numbers; None to write none, and to fit no fusion.
        settings: of the training.
        backend: that trains.
    """
    # Spawned, because a forked process starts with this one's memory.
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_trained, (frames, path, settings, backend))


def _trained(
    frames: Path, path: Path | None, settings: TrainingSettings, backend: BackendName
) -> MeasuredTraining:
    """Runs in a process of its own."""
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.memory import peak_memory, reset_peak, resident_memory
    from hybrid.training.forest import train
    from hybrid.training.views import labelled_views
    from pathtrace.base.backend import select_backend
    from pathtrace.dataset.frames import read_frame_set
    from splat.training.trainer import Trainer

    select_backend(backend)
    found = read_frame_set(frames)
    before, taken = resident_memory(), MeasuredTraining(0.0, 0)
    reset_peak()
    start = time.perf_counter()

    def step(done: int, total: int) -> None:
        nonlocal taken
        if done == settings.iterations:
            taken = MeasuredTraining(time.perf_counter() - start, peak_memory() - before)

    if path is None:
        Trainer(device_arrays(), labelled_views(found, settings), settings).run(lambda done: step(done, done))
    else:
        train(found, path, settings, step, precision=Precision.FLOAT32)
    return taken
