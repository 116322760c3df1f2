"""Which settings the window chooses from, and how they are measured."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import FrameSettings
from hybrid.window import frame_loop as ladder
from hybrid.window.frame_loop import candidates, ladder_for
from hybrid.window.frame_source import SceneSource
from hybrid.window.messages import Request

BASE = FrameSettings(fov_a=20.0, fov_b=10.0, spp=4, acuity_model="fov-gs", layers=(2, 3))


@pytest.mark.parametrize("layers", [1, 4])
def test_candidates_differ_and_suit_any_forest(layers):
    wanted = candidates(BASE, layers)
    assert len(set(wanted)) == len(wanted)
    # All layers, however many there will be, and all but the finest.
    assert {one.layers for one in wanted} == ({None} if layers == 1 else {None, (1, layers - 1)})


def test_candidates_go_from_coarse_to_fine_in_every_way():
    wanted = candidates(BASE, 4)
    assert {one.scale for one in wanted} == {0.5, 0.75, 1.0}
    assert {one.rate for one in wanted} == {0, 1}
    assert {one.spp for one in wanted} == {1, 2, 4}
    assert (min(one.fov_a for one in wanted), max(one.fov_a for one in wanted)) == (5, 30)


def test_candidates_keep_acuity_model_display_and_share_of_the_band():
    for one in candidates(BASE, 4):
        assert (one.acuity_model, one.display) == ("fov-gs", BASE.display)
        assert one.fov_b == pytest.approx(0.5 * one.fov_a)
    assert all(one.fov_b == 0 for one in candidates(replace(BASE, fov_a=0.0, fov_b=0.0), 4))


class Timed:
    """In place of a source's `show`: frames that take 10 ms per percent of radius and 100 ms per sample.

    The first two of each settings take ten times as long. Radiance is 0.5 if the gaze is in the middle and
    there is no history, else 0.4.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now = 0.0
        self.gazes: dict[FrameSettings, list[Gaze]] = {}
        self.requests: list[Request] = []
        self.history = True
        monkeypatch.setattr(time, "perf_counter", lambda: self.now)

    def show(self, request: Request, quick: bool) -> Any:
        assert quick
        settings = replace(request.settings, gaze=Gaze(), camera=None)
        seen = self.gazes.setdefault(settings, [])
        seen.append(request.settings.gaze)
        slow = 10 if len(seen) <= 2 else 1
        self.now += slow * (0.01 * settings.fov_a + 0.1 * settings.spp)
        self.requests.append(request)
        assert request.settings.camera is not None
        camera, _ = request.settings.resolved(request.settings.camera)
        value = 0.4 if self.history or request.settings.gaze != Gaze() else 0.5
        self.history = True
        composite = np.full((camera.height, camera.width, 3), value, dtype=np.float32)
        return SimpleNamespace(frame=SimpleNamespace(composite=composite))

    def forget(self) -> None:
        self.history = False


@pytest.fixture
def timed(source, monkeypatch, own_home) -> Timed:
    """The source shows made-up frames; JOD is ten times their radiance, plus a hundredth per percent."""
    made = Timed(monkeypatch)
    monkeypatch.setattr(source, "show", made.show)
    monkeypatch.setattr(source, "forget", made.forget)

    def reference(tracer: object, camera: Camera, spp: int, seed: int) -> SimpleNamespace:
        return SimpleNamespace(radiance=np.ones((camera.height, camera.width, 3), dtype=np.float32))

    def jod(image: np.ndarray, reference: np.ndarray, display: object, gaze: Gaze) -> float:
        assert image.shape == reference.shape
        assert gaze == Gaze()
        return 10 * float(image.mean()) + 0.01 * made.requests[-1].settings.fov_a

    monkeypatch.setattr(ladder, "reference", reference)
    monkeypatch.setattr(ladder, "jod", jod)
    return made


def like(source: SceneSource, width: int = 96, **settings: Any) -> Request:
    camera = source.camera.resized(width, 64)
    return Request(FrameSettings(gaze=Gaze(0.1, 0.9), fov_a=20.0, fov_b=15.0, camera=camera, **settings))


def test_times_are_medians_without_warm_up_and_quality_is_that_of_a_centred_gaze(source, timed):
    rungs = ladder_for(source, like(source, scale=0.5), lambda *step: None)
    # One sample is best here; the larger the disc, the better and the slower.
    assert [one.settings.fov_a for one in rungs] == [5, 8, 11, 15, 20, 25, 30]
    for one in rungs:
        assert one.milliseconds == pytest.approx(10 * one.settings.fov_a + 100)
        assert one.quality == pytest.approx(5 + 0.01 * one.settings.fov_a)
    for gazes in timed.gazes.values():
        assert len(gazes) == 10
        assert gazes[7:] == 3 * [Gaze()]
        assert len(set(gazes[:7])) == 7


def test_quality_is_judged_on_several_views_that_are_not_the_scenes_own(source, timed):
    own = source.camera.resized(96, 64)
    ladder_for(source, like(source), lambda *step: None)
    for first in range(0, len(timed.requests), 10):
        cameras = [request.settings.camera for request in timed.requests[first : first + 10]]
        assert all(camera == own for camera in cameras[:7])
        assert own not in cameras[7:]
        assert len(set(cameras[7:])) == 3


def test_where_there_is_no_jod_it_is_ssim(source, timed, monkeypatch):
    monkeypatch.setattr(ladder, "jod", lambda *arguments: None)
    monkeypatch.setattr(ladder, "ssim", lambda image, truth: 0.9)
    rungs = ladder_for(source, like(source), lambda *step: None)
    assert [one.quality for one in rungs] == [0.9]
    assert rungs[0].settings.fov_a == 5


def test_a_ladder_is_measured_once_for_each_size_acuity_model_and_display(source, timed):
    said: list[tuple[int, int, str]] = []
    report = lambda *step: said.append(step)  # noqa: E731
    rungs = ladder_for(source, like(source), report)
    # One step for each of the candidates, whose number is that of the steps before the last one.
    assert [done for done, _, _ in said] == list(range(len(timed.gazes) + 2))
    assert {total for _, total, _ in said} == {len(timed.gazes) + 1}
    # Nothing of all this is left in the next frame of the window.
    assert not timed.history
    said.clear()
    again = ladder_for(source, like(source, rate=1), report)
    assert not said
    assert [(one.milliseconds, one.quality) for one in again] == [
        (one.milliseconds, one.quality) for one in rungs
    ]
    others = like(source, display="hmd"), like(source, acuity_model="none"), like(source, width=80)
    for other in others:
        said.clear()
        ladder_for(source, other, report)
        assert said


def test_a_real_ladder_is_read_from_its_file(source, own_home, monkeypatch):
    monkeypatch.setattr(ladder, "candidates", lambda base, layers: candidates(base, layers)[::6])
    request = like(source)
    rungs = ladder_for(source, request, lambda *step: None)
    assert rungs[-1].quality > 0
    assert all(a.milliseconds < b.milliseconds and a.quality < b.quality for a, b in pairwise(rungs))
    assert ladder_for(source, request, lambda *step: pytest.fail("measured again")) == rungs
