"""What the window shows of a real scene, request by request."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import drjit as dr
import numpy as np
import pytest

from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.cli.options import loaded_scene
from hybrid.frame.live import LiveRenderer
from hybrid.frame.periphery import Viewing
from hybrid.interactive.ladder import ladder_for
from hybrid.interactive.request import Request, Settings, Shows
from hybrid.interactive.source import FrameSource
from hybrid.output.images import read_layers
from splat.io.forest_file import load_forest


@pytest.fixture(scope="module")
def source(backend, made) -> FrameSource:
    forest = load_forest(made / "box.forest")
    viewing = Viewing(DISPLAYS["desktop"])
    return FrameSource(LiveRenderer(loaded_scene("cornell"), forest, viewing))


def request(source: FrameSource, shows: Shows = Shows.COMPOSITE, **settings: object) -> Request:
    camera = source.camera.resized(96, 64)
    return Request(camera, Gaze(0.4, 0.5), Settings(fov_a=20.0, fov_b=15.0, **settings), shows, 0.0)  # type: ignore[arg-type]


def test_the_same_once_more_has_more_samples_and_anything_else_has_not(source):
    source.forget()
    asked = request(source)
    first, second = source.show(asked, False), source.show(asked, False)
    assert second.spp == pytest.approx(first.spp + 1, abs=0.05)
    patient = source.show(asked, True)
    assert patient.spp == pytest.approx(first.spp + 7, abs=0.05)
    assert patient.frame.periphery is first.frame.periphery
    assert not patient.finished
    elsewhere = source.show(replace(asked, gaze=Gaze(0.9, 0.9)), False)
    assert elsewhere.spp < 1.5
    assert elsewhere.paths == len(elsewhere.frame.region.pixels)


def test_the_disc_converges_to_the_path_traced_frame(source):
    source.forget()
    asked = request(source, Shows.SPLIT)
    for _ in range(2 * 24):
        shown = source.show(asked, True)
    assert shown.reference_spp == 24
    region, reference = (
        shown.frame.region,
        source._converging.image().reshape(-1, 3)[shown.frame.region.pixels],
    )
    difference = np.abs(np.clip(shown.frame.fovea.radiance, 0, 1) - np.clip(reference, 0, 1))
    assert len(region.pixels)
    assert difference.mean() < 0.05


def test_times_are_those_of_passes_that_were_made(source):
    source.forget()
    first = source.show(request(source, Shows.PATH_TRACED), False).milliseconds
    assert {"trace", "fovea", "splat", "reference", "picture"} < first.keys()
    again = source.show(request(source, Shows.PATH_TRACED), False).milliseconds
    assert again.keys() == {"reference", "picture", "total"}
    for passes in (first, again):
        assert passes["total"] == pytest.approx(sum(passes.values()) - passes["total"], rel=0.01)


def test_every_view_has_the_frames_size(source):
    for shows in Shows:
        for scale in (1.0, 0.5):
            shown = source.show(request(source, shows, scale=scale), False)
            assert shown.picture.shape == (64 * scale, 96 * scale, 3)
            assert shown.picture.flags.c_contiguous
            assert shown.picture.dtype == np.uint8


def kernels(source: FrameSource, asked: list[Request], patient: bool = False) -> set[str]:
    """Those that frames were made with."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for one in asked:
            source.show(one, patient)
        return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}


def test_other_sizes_places_and_samples_need_no_other_kernels(source):
    def resized(width: int, height: int, x: float) -> Request:
        return replace(request(source), camera=source.camera.resized(width, height), gaze=Gaze(x, 0.5))

    def frames(widths: range) -> list[Request]:
        return [resized(width, width // 2 + 11, 0.2 + 0.4 * (width % 3)) for width in widths]

    assert len(kernels(source, frames(range(96, 160, 7)))) > 20
    known = kernels(source, frames(range(96, 160, 7)))
    # Another gaze may mix other rates. But what depended on the size would be another kernel for each of ten.
    assert len(kernels(source, frames(range(99, 163, 7))) - known) < 8
    still = [resized(96, 64, 0.4)] * 4
    known = kernels(source, still, True)
    # What depended on the number of samples would be another one for each frame.
    assert len(kernels(source, still, True) - known) < len(still)


def test_layers_law_and_rate_are_those_that_were_chosen(source):
    fine = source.show(request(source), False).frame
    coarse = source.show(request(source, layers=(1, 1)), False).frame
    assert coarse.detail.drawn_level.max() == 1 < fine.detail.drawn_level.max()
    assert source.show(request(source, rate=2), False).frame.detail.drawn_rate.min() >= 2
    assert source.show(
        request(source, acuity_model="none"), False
    ).frame.detail.cutoff.min() == pytest.approx(0.5)


def test_a_coarser_frame_is_seen_under_the_same_angle(source):
    whole = source.show(request(source), False).frame.detail.eccentricity
    half = source.show(request(source, scale=0.5), False).frame.detail.eccentricity
    assert half[0, 0] == pytest.approx(whole[0, 0], rel=0.01)


def test_files_hold_what_is_shown(source, tmp_path):
    shown = source.show(request(source), False)
    source.save(tmp_path / "a.png", tmp_path / "a.exr")
    layers = read_layers(tmp_path / "a.exr")
    assert (layers["composite.G"] == shown.frame.composite[..., 1]).all()
    assert (tmp_path / "a.png").is_file()


def test_a_ladder_is_measured_once(source, own_home):
    said = []
    ladder = ladder_for(source, request(source), lambda *step: said.append(step))
    # A bar goes away when all is done.
    assert said[-1][1] == said[-1][2]
    assert all(a.milliseconds < b.milliseconds for a, b in pairwise(ladder))
    said.clear()
    assert ladder_for(source, request(source), lambda *step: said.append(step)) == ladder
    assert not said
    # To another viewer the same frames are worth something else.
    source.display = DISPLAYS["hmd"]
    ladder_for(source, request(source), lambda *step: said.append(step))
    source.display = DISPLAYS["desktop"]
    assert said
