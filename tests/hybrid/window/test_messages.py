"""Slots that hold the newest item, requests, and what is shown."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.samples import Samples
from hybrid.base.compute_device import device_arrays
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import Newest, Request, ShownFrame, ShownView


def test_the_newest_item_is_taken_once():
    slot: Newest[int] = Newest()
    assert slot.take() is None
    for item in range(5):
        slot.put(item)
    assert slot.take() == 4
    assert slot.take() is None


def test_a_look_at_the_newest_item_leaves_it_there():
    slot: Newest[int] = Newest()
    assert slot.peek() is None
    for item in range(3):
        slot.put(item)
    assert slot.peek() == 2
    assert slot.take() == 2
    assert slot.peek() is None


def test_taking_from_an_empty_slot_gives_up():
    assert Newest[int]().take(0.01) is None


def test_an_item_wakes_whoever_waits():
    slot: Newest[str] = Newest()
    taken: list[str | None] = []
    waits = threading.Thread(target=lambda: taken.append(slot.take(600)), daemon=True)
    waits.start()
    slot.put("here")
    waits.join(60)
    assert taken == ["here"]


def test_what_many_threads_put_last_is_not_lost():
    slot: Newest[int] = Newest()
    threads = [threading.Thread(target=lambda: [slot.put(n) for n in range(1000)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert slot.take() == 999


def camera(x: float = 0.0) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera(pose, 64, 48, 50.0, 50.0, 32.0, 24.0)


SETTINGS = FrameSettings(gaze=Gaze(0.3, 0.4), camera=camera())
REQUEST = Request(SETTINGS, ShownView.SPLIT, 5.0, 15.0)


def test_the_same_frame_may_be_asked_for_at_another_time_with_an_equal_camera():
    again = Request(replace(SETTINGS, camera=camera()), ShownView.SPLIT, 6.0, 15.0, REQUEST.asked + 1)
    assert again.settings.camera is not SETTINGS.camera
    assert REQUEST.same_frame(again)


@pytest.mark.parametrize(
    "other",
    [
        None,
        replace(REQUEST, view=ShownView.COMPOSITE),
        replace(REQUEST, target_fps=None),
        replace(REQUEST, target_fps=30.0),
        replace(REQUEST, settings=replace(SETTINGS, gaze=Gaze(0.3, 0.41))),
        replace(REQUEST, settings=replace(SETTINGS, spp=5)),
        replace(REQUEST, settings=replace(SETTINGS, camera=camera(0.1))),
        replace(REQUEST, settings=replace(SETTINGS, display="hmd")),
    ],
)
def test_anything_else_is_another_frame(other):
    assert not REQUEST.same_frame(other)


def test_views_come_in_the_order_of_their_keys():
    names = "COMPOSITE FOVEA PERIPHERY PATH_TRACED SPLIT LEVELS DIFFERENCE"
    assert [view.name for view in ShownView] == names.split()


def test_three_views_show_a_path_traced_frame():
    needing = {view for view in ShownView if view.needs_path_traced}
    assert needing == {ShownView.PATH_TRACED, ShownView.SPLIT, ShownView.DIFFERENCE}


pytestmark = pytest.mark.usefixtures("backend")


def shown(counts: list[float]) -> ShownFrame:
    plain = device_arrays().plain
    nothing = Samples.none(device_arrays(), dr.arange(plain.UInt, len(counts)))
    samples = replace(nothing, count=plain.Float(counts))
    frame = SimpleNamespace(fovea=SimpleNamespace(samples=samples))
    return ShownFrame(np.zeros((4, 4, 3), np.uint8), None, frame, 0, {}, 0, False)  # type: ignore[arg-type]


def test_samples_per_pixel_are_the_mean_over_the_disc():
    assert shown([1, 2, 6]).spp == pytest.approx(3)


def test_an_empty_disc_has_no_samples():
    assert shown([]).spp == 0
