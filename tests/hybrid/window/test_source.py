"""What the window shows of a real scene, request by request."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np
import pytest
from PIL import Image as Pillow

from compose.eye.gaze import Gaze
from hybrid.base import compute_device
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.image_files import read_exr
from hybrid.window import frame_source as source_module
from hybrid.window.frame_source import SceneSource
from hybrid.window.messages import Request, ShownView
from pathtrace.scene.triangles import Surfaces
from pathtrace.trace.film import frame_positions
from tests.compose.arrays_of import numbers


def request(source: SceneSource, view: ShownView = ShownView.COMPOSITE, **settings: Any) -> Request:
    camera = source.camera.resized(96, 64)
    base = FrameSettings(gaze=Gaze(0.4, 0.5), fov_a=20.0, fov_b=15.0, spp=1, camera=camera)
    return Request(replace(base, **settings), view)


def test_a_source_knows_its_scene(source):
    ready = source.ready()
    assert (ready.name, ready.layers, ready.seconds) == ("cornell", 2, None)
    assert ready.camera is source.renderer.scene.camera
    # What the renderer's own rays hit; the box is some units deep.
    small = source.camera.resized(24, 24)
    hits = source.renderer.tracer.hits(small, frame_positions(small)).distance
    assert ready.distance == pytest.approx(np.median(hits[np.isfinite(hits)]), rel=0.02)


def test_where_nothing_is_seen_the_distance_is_one(source, monkeypatch):
    monkeypatch.setattr(Surfaces, "median_distance", lambda self, camera: np.inf)
    assert source.ready().distance == 1


def test_a_repeated_request_has_more_samples_and_any_other_has_not(source):
    asked = request(source)
    first, second = source.show(asked, True), source.show(asked, True)
    assert second.spp == pytest.approx(first.spp + 1, abs=0.05)
    patient = source.show(asked, False)
    assert patient.spp == pytest.approx(first.spp + 7, abs=0.05)
    assert patient.paths == 6 * patient.frame.region.count
    np.testing.assert_array_equal(patient.frame.periphery, first.frame.periphery)
    assert not patient.finished
    elsewhere = source.show(replace(asked, settings=replace(asked.settings, gaze=Gaze(0.9, 0.9))), True)
    assert elsewhere.spp < 1.5
    assert elsewhere.paths == elsewhere.frame.region.count
    assert elsewhere.request.settings.gaze == Gaze(0.9, 0.9)


def test_many_samples_are_no_fewer_when_there_is_time(source):
    asked = request(source, spp=9)
    source.show(asked, True)
    assert source.show(asked, False).paths == 9 * source.show(asked, True).frame.region.count


def test_each_frame_has_samples_of_its_own(source):
    asked = request(source)
    first = numbers(source.show(asked, True).frame.fovea.samples, "radiance")
    source.forget()
    second = numbers(source.show(asked, True).frame.fovea.samples, "radiance")
    assert not np.array_equal(first, second)


def test_after_forgetting_a_frame_begins_anew(source):
    asked = request(source)
    source.show(asked, False)
    source.show(asked, False)
    source.forget()
    assert source.show(asked, True).spp == 1


def test_a_frame_with_enough_samples_is_finished(source, monkeypatch):
    asked = request(source)
    monkeypatch.setattr(source_module, "_ENOUGH", 2)
    first, second, third = (source.show(asked, True) for _ in range(3))
    assert [one.finished for one in (first, second, third)] == [False, False, True]
    assert second.spp == pytest.approx(2, abs=0.05)
    assert third.frame is second.frame
    assert third.paths == 0


def test_without_a_disc_the_second_frame_is_finished(source):
    asked = request(source, fov_a=0.0, fov_b=0.0)
    first, second = source.show(asked, True), source.show(asked, True)
    assert (first.paths, first.spp) == (0, 0)
    assert first.finished
    assert second.frame is first.frame


def test_the_path_traced_frame_alone_traces_no_disc_again(source):
    asked = request(source, ShownView.PATH_TRACED)
    first, second = source.show(asked, True), source.show(asked, True)
    # A sixteenth of the frame, in the first frame beside the disc.
    assert first.paths == first.frame.region.count + 24 * 16
    assert second.paths == 24 * 16
    assert second.frame is first.frame
    assert source.show(asked, False).paths == 8 * 24 * 16
    assert not second.finished


def test_the_path_traced_frame_is_kept_until_the_camera_moves(source):
    asked = request(source, ShownView.SPLIT)
    first = source.show(asked, False)
    assert first.path_traced_spp == 0
    other_gaze = replace(asked, settings=replace(asked.settings, gaze=Gaze(0.6, 0.5)))
    assert source.show(other_gaze, False).path_traced_spp == 1
    assert source.show(request(source), True).path_traced_spp == 0
    assert source.show(asked, False).path_traced_spp == 1
    assert source.show(asked, False).path_traced_spp == 2
    smaller = replace(asked, settings=replace(asked.settings, scale=0.5))
    assert source.show(smaller, False).path_traced_spp == 0


def test_a_complete_path_traced_frame_is_finished(source, monkeypatch):
    asked = request(source, ShownView.PATH_TRACED)
    monkeypatch.setattr("hybrid.window.window_views._MOST_SAMPLES", 1)
    shown = [source.show(asked, False) for _ in range(3)]
    assert [one.path_traced_spp for one in shown] == [0, 1, 1]
    assert [one.finished for one in shown] == [False, True, True]
    assert shown[2].paths == 0


def test_the_disc_converges_to_the_path_traced_frame(source):
    for _ in range(2 * 24):
        composite = source.show(request(source, ShownView.SPLIT), False)
    assert composite.path_traced_spp == 24
    path_traced = source.show(request(source, ShownView.PATH_TRACED), True)
    # In the left half, where a split view shows the composite.
    left = np.flatnonzero((composite.frame.region.weight_image() == 1) & (np.arange(96) < 48))
    disc, whole = (shown.image.reshape(-1, 3)[left].astype(int) for shown in (composite, path_traced))
    assert len(left) > 100
    assert np.abs(disc - whole).mean() < 0.05 * 255
    # In the other half, it is the path-traced frame, but for the samples added since.
    assert np.abs(composite.image[:, 49:].astype(int) - path_traced.image[:, 49:]).mean() < 2


def test_times_are_those_of_the_passes_that_were_run(source):
    first = source.show(request(source, ShownView.PATH_TRACED), True).milliseconds
    assert {"trace", "fovea", "splat", "reference", "picture"} < first.keys()
    again = source.show(request(source, ShownView.PATH_TRACED), True).milliseconds
    assert again.keys() == {"reference", "picture", "total"}
    for passes in (first, again):
        assert passes["total"] == pytest.approx(sum(passes.values()) - passes["total"], rel=0.01)


@pytest.mark.parametrize("view", ShownView)
def test_every_view_has_the_size_of_the_frame(source, view):
    for scale in (1.0, 0.5):
        shown = source.show(request(source, view, scale=scale), True)
        assert shown.image.shape == (64 * scale, 96 * scale, 3)
        # As Qt reads it.
        assert shown.image.flags.c_contiguous
        assert shown.image.dtype == np.uint8


def kernels(source: SceneSource, requests: list[Request], quick: bool = True) -> set[str]:
    """Hashes of the kernels that frames were made with."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for one in requests:
            source.show(one, quick)
        return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}


def test_other_sizes_gazes_and_samples_need_no_other_kernels(source):
    def resized(width: int, height: int, x: float) -> Request:
        return request(source, camera=source.camera.resized(width, height), gaze=Gaze(x, 0.5))

    def frames(widths: range) -> list[Request]:
        return [resized(width, width // 2 + 11, 0.2 + 0.4 * (width % 3)) for width in widths]

    assert len(kernels(source, frames(range(96, 160, 7)))) > 20
    known = kernels(source, frames(range(96, 160, 7)))
    # Another gaze may mix other rates. But what depended on the size would be one kernel for each of nine.
    assert len(kernels(source, frames(range(99, 160, 7))) - known) < 8
    still = [resized(96, 64, 0.4)] * 4
    known = kernels(source, still, quick=False)
    # What depended on the number of samples would be another one for each frame.
    assert len(kernels(source, still, quick=False) - known) < len(still)


def test_layers_acuity_model_and_rate_are_the_requested_ones(source):
    fine = source.show(request(source), True).frame
    coarse = source.show(request(source, layers=(1, 1)), True).frame
    assert coarse.detail.drawn_level.max() == 1 < fine.detail.drawn_level.max()
    assert source.show(request(source, rate=2), True).frame.detail.drawn_rate.min() >= 2
    unlimited = source.show(request(source, acuity_model="none"), True).frame
    assert unlimited.detail.cutoff.min() == pytest.approx(0.5)


def test_a_coarser_frame_is_seen_under_the_same_angle(source):
    whole = source.show(request(source), True).frame.detail.eccentricity
    half = source.show(request(source, scale=0.5), True).frame.detail.eccentricity
    assert half[0, 0] == pytest.approx(whole[0, 0], rel=0.01)


def test_files_hold_what_is_shown(source, tmp_path):
    source.save(tmp_path / "nothing.png")
    assert not list(tmp_path.iterdir())
    shown = source.show(request(source), True)
    source.save(tmp_path / "a.png")
    assert (read_exr(tmp_path / "a.exr")["composite.G"] == shown.frame.composite[..., 1]).all()
    assert (np.asarray(Pillow.open(tmp_path / "a.png")) == shown.image).all()


def test_unused_memory_is_released_every_two_seconds(source, monkeypatch):
    now, released = [1000.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(compute_device, "release_memory", lambda: released.append(now[0]))
    monkeypatch.setattr(source, "_memory", compute_device.SpareMemory())
    asked = request(source, fov_a=0.0, fov_b=0.0)
    for now[0] in (1001.0, 1001.9, 1002.1, 1003.0, 1004.0, 1004.2):
        source.show(asked, True)
    assert released == [1002.1, 1004.2]
