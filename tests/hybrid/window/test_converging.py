"""The path-traced frame converges: to the right mean, everywhere at once, and to an end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import Camera
from hybrid.window import window_views as converging
from hybrid.window.window_views import ConvergingFrame
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
WIDTH, HEIGHT = 10, 7
STAND_IN = np.full((HEIGHT, WIDTH, 3), 9.0, dtype=np.float32)


def camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    return Camera(np.eye(4), width, height, 8.0, 8.0, width / 2, height / 2)


class Steps:
    """A tracer whose n-th step, from 1, has the radiance (n, 2 n, 0) everywhere."""

    def __init__(self) -> None:
        self.pixels: list[np.ndarray] = []
        self.seeds: list[int] = []
        self.offsets: list[int] = []

    def trace(
        self, camera: Camera, positions: Any, spp: int, seed: int, offset: int, pattern: int
    ) -> SimpleNamespace:
        x, y = positions.x.numpy().astype(int), positions.y.numpy().astype(int)
        self.pixels.append(y * camera.width + x)
        self.seeds.append(seed)
        self.offsets.append(offset)
        step, ones = len(self.pixels), np.ones(len(x), dtype=np.float32)
        return SimpleNamespace(
            radiance=[mi.Float(step * ones), mi.Float(2 * step * ones), mi.Float(0 * ones)]
        )


def test_sixteen_steps_sample_each_pixel_once_spread_over_the_frame():
    tracer = Steps()
    frame = ConvergingFrame(tracer, camera(), STAND_IN)  # type: ignore[arg-type]
    traced = [frame.refine() for _ in range(16)]
    assert frame.samples == 1
    assert traced == [len(pixels) for pixels in tracer.pixels]
    assert sorted(np.concatenate(tracer.pixels)) == list(range(WIDTH * HEIGHT))
    for pixels in tracer.pixels:
        x, y = pixels % WIDTH, pixels // WIDTH
        # One pixel of each block of four by four.
        assert len(set(x % 4)) == len(set(y % 4)) == 1
    # The first two steps are as far apart as can be: half a block.
    first, second = (np.array([p[0] % WIDTH % 4, p[0] // WIDTH % 4]) for p in tracer.pixels[:2])
    assert abs(second - first).tolist() == [2, 2]


def test_pixels_without_a_sample_show_the_stand_in():
    tracer = Steps()
    frame = ConvergingFrame(tracer, camera(), STAND_IN)  # type: ignore[arg-type]
    assert (frame.image() == STAND_IN).all()
    for _ in range(5):
        frame.refine()
    assert frame.samples == 0
    image = frame.image().reshape(-1, 3)
    for step, pixels in enumerate(tracer.pixels, 1):
        assert (image[pixels] == [step, 2 * step, 0]).all()
    untouched = np.setdiff1d(np.arange(WIDTH * HEIGHT), np.concatenate(tracer.pixels))
    assert (image[untouched] == 9).all()


def test_the_image_is_the_mean_of_all_samples():
    tracer = Steps()
    frame = ConvergingFrame(tracer, camera(), STAND_IN)  # type: ignore[arg-type]
    for _ in range(33):
        frame.refine()
    assert frame.samples == 2
    image = frame.image().reshape(-1, 3)
    # Steps 1, 17 and 33 sampled the same pixels; steps 2 and 18 others.
    assert (image[tracer.pixels[0]] == [17, 34, 0]).all()
    assert (image[tracer.pixels[1]] == [10, 20, 0]).all()


def test_each_step_has_other_samples_that_fill_the_gaps_of_those_before():
    tracer = Steps()
    frame = ConvergingFrame(tracer, camera(), STAND_IN)  # type: ignore[arg-type]
    for _ in range(48):
        frame.refine()
    assert len(set(tracer.seeds)) == 48
    assert tracer.offsets == [0] * 16 + [1] * 16 + [2] * 16


def test_a_frame_smaller_than_a_block_takes_steps_without_pixels():
    frame = ConvergingFrame(Steps(), camera(2, 1), STAND_IN[:1, :2])  # type: ignore[arg-type]
    assert sorted(frame.refine() for _ in range(16)) == [0] * 14 + [1] * 2
    assert frame.samples == 1


def test_it_is_complete_when_every_pixel_has_all_samples(monkeypatch):
    monkeypatch.setattr(converging, "_MOST_SAMPLES", 2)
    frame = ConvergingFrame(Steps(), camera(), STAND_IN)  # type: ignore[arg-type]
    for _ in range(31):
        frame.refine()
    assert not frame.complete
    frame.refine()
    assert frame.complete


@pytest.fixture(scope="module")
def tracer(backend) -> Tracer:
    return Tracer(load_scene(small.corner()))


def refined(tracer: Tracer, view: Camera, samples: int) -> ConvergingFrame:
    frame = ConvergingFrame(tracer, view, np.zeros((view.height, view.width, 3), dtype=np.float32))
    while frame.samples < samples:
        frame.refine()
    return frame


def test_the_mean_of_a_real_scene_has_no_bias(tracer):
    view = tracer.scene.camera
    found = tracer.trace(view, frame_positions(view), 1024, 5)
    truth, squares = interleaved(found.radiance), interleaved(found.squares)
    # 16 samples have a sixteenth of one sample's variance, strata even less; channels vary together.
    deviation = np.sqrt((squares - truth**2).clip(0).mean() / 16 / len(truth))
    error = refined(tracer, view, 16).image().mean() - truth.mean()
    assert abs(error) < 4 * deviation
    assert deviation < 0.02 * truth.mean()


def test_denoising_few_samples_brings_them_closer_to_the_truth(tracer):
    view = tracer.scene.camera
    truth = interleaved(tracer.trace(view, frame_positions(view), 1024, 5).radiance)
    frame = refined(tracer, view, 1)
    errors = [
        np.abs(np.clip(image.reshape(-1, 3), 0, 1) - np.clip(truth, 0, 1)).mean()
        for image in (frame.denoised(), frame.image())
    ]
    assert errors[0] < 0.7 * errors[1]
