"""Scores of images, in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PillowImage

from compose.base.errors import UserError
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.evaluation.scoring import ScoringTask, score, scorers
from hybrid.measure.frame_quality import METRICS, Viewer
from hybrid.measure.image_metrics import plain_regions
from hybrid.measure.perceptual_metrics import flip_map
from tests import small

SIZE = 48
REFERENCE = small.rng().uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)


def task(
    error: float, flip_file: Path | None = None, metrics: tuple[str, ...] = tuple(METRICS)
) -> ScoringTask:
    """An image that is brighter than its reference by a factor."""
    parts = plain_regions(Foveation(Gaze(), 30, 30), (SIZE, SIZE), ("whole", "foveal"))
    viewer = Viewer(Display(SIZE, SIZE, 10.0), Gaze())
    image = REFERENCE * np.float32(1 + error)
    return ScoringTask("baseline", image, REFERENCE, parts, viewer, metrics, flip_file)


def table(rows: list[dict]) -> dict[tuple[str, str], float]:
    return {(row["region"], row["metric"]): row["value"] for row in rows}


def test_only_what_is_wanted_is_measured():
    found = table(score(task(0.1, metrics=("ssim", "psnr"))))
    assert set(found) == {(region, metric) for region in ("whole", "foveal") for metric in ("ssim", "psnr")}


def test_the_map_of_flip_is_written_in_colours(tmp_path):
    pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")
    file = tmp_path / "flip.png"
    found = table(score(task(0.3, file)))
    shown = np.asarray(PillowImage.open(file)).astype(int)
    assert shown.shape == (SIZE, SIZE, 3)
    error = flip_map(task(0.3).image, REFERENCE, task(0.3).viewer.display.pixels_per_degree)
    assert found["whole", "flip"] == pytest.approx(float(error.mean()))
    # Magma gets brighter with the error, and is black where there is none.
    order = np.argsort(error.ravel())
    brightness = shown.sum(axis=2).ravel()[order]
    assert brightness[-100:].mean() > brightness[:100].mean()
    score(task(0.0, file))
    assert np.asarray(PillowImage.open(file)).max() < 5


def test_an_image_that_cannot_be_compared_is_named():
    broken = task(float("nan"))
    with pytest.raises(UserError, match="baseline has 2304 pixels that are not finite"):
        score(broken)


def test_results_come_in_the_order_of_the_tasks_and_errors_are_passed_on():
    """More tasks than are in flight at once; images are rendered only a few ahead. Processes are kept."""
    workers = len(os.sched_getaffinity(0))
    count, rendered, psnr = 2 * workers + 4, [], []

    def tasks():
        for number in range(count):
            rendered.append(number)
            yield task(0.01 * number)
        yield task(float("nan"))

    with scorers() as scored:
        results = scored(tasks())
        for _ in range(count):
            psnr.append(table(next(results))["whole", "psnr"])
            assert len(rendered) <= len(psnr) + 2 * workers
        with pytest.raises(UserError, match="not finite"):
            next(results)
        (again,) = scored([task(0.01)])
        assert table(again)["whole", "psnr"] == psnr[1]
    assert psnr == sorted(psnr, reverse=True)
    assert psnr[0] == 120


def test_a_program_from_the_standard_input_is_not_run_again():
    script = """
print("once")
from hybrid.evaluation.scoring import scorers
from tests.hybrid.evaluation.test_scoring import task
with scorers() as scored:
    print([len(rows) > 0 for rows in scored(task(0.1) for _ in range(2))])
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-"], input=script, capture_output=True, text=True, timeout=300, env=environment
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["once", "[True, True]"]


_PARENT = """
import multiprocessing, os, sys
from concurrent.futures import ProcessPoolExecutor
from hybrid.evaluation.scoring import _start_worker
if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _start_worker)
    print(pool.submit(os.getpid).result(), flush=True)
    sys.stdin.read()
"""


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_worker_ends_with_a_killed_parent(tmp_path):
    (tmp_path / "parent.py").write_text(_PARENT)
    pipe = subprocess.PIPE
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    parent = subprocess.Popen(
        [sys.executable, tmp_path / "parent.py"], stdin=pipe, stdout=pipe, env=environment, text=True
    )
    worker = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    for _ in range(100):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.kill(worker, signal.SIGKILL)
    raise AssertionError("the worker waits for ever")
