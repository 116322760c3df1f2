"""Whole frames by mode and size."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from compose.fovea.foveation import FoveaMode
from hybrid.evaluation.frame_bench import HostBytes, bench_frame
from hybrid.render import frame_renderer as module
from hybrid.render.forest_attachments import attach_views
from hybrid.render.frame_renderer import LiveRenderer, Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest

FIELDS = ["mode", "live", "width", "height", "wall_ms", "kernels_ms", "launches", "host_bytes"]
# Bytes.
MEBIBYTE = 1 << 20
# Sides of square frames in pixels, and bytes by which their images differ.
SMALL, LARGE = 64, 256
# Kernels, copies and the like of a frame.
MOST_LAUNCHES = {FoveaMode.RAW: 45, FoveaMode.DENOISED: 70, FoveaMode.FUSED: 70}
IMAGE = 12 * (LARGE**2 - SMALL**2)


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def forest(scene) -> Forest:
    return rough_forest(scene)


@pytest.fixture(scope="module")
def measure(scene, forest):
    def measured(*sizes: tuple[int, int]) -> list[dict]:
        settings, rounds = FrameSettings(fov_a=30, fov_b=20, spp=1), []
        rows = bench_frame(
            scene, forest, settings, sizes, 3, 1, 0, lambda done, total: rounds.append((done, total))
        )
        assert rounds[-1][0] == rounds[-1][1] == len(rounds)
        return rows

    return measured


@pytest.fixture(scope="module")
def rows(measure):
    return measure((48, 32), (64, 48))


def test_each_mode_and_size_has_a_row_per_renderer(rows, backend):
    cases = [(mode.value, live) for mode in FoveaMode for live in (False, True)]
    assert [(row["mode"], row["live"]) for row in rows] == 2 * cases
    assert [(row["width"], row["height"]) for row in rows] == [(48, 32)] * 6 + [(64, 48)] * 6
    for row in rows:
        assert [*row] == [*FIELDS, "passes", "backend"]
        assert backend.variant.startswith(row["backend"])
        assert 0 < row["wall_ms"]["p50"] <= row["wall_ms"]["p95"]
        assert row["kernels_ms"] > 0
        assert row["launches"] > 0
        assert row["host_bytes"] > 0
        assert {"trace", "fovea", "splat", "total"} <= {*row["passes"]}
        assert all(0 <= times["p50"] <= times["p95"] for times in row["passes"].values())


def test_an_image_made_on_the_host_is_seen(measure, rows, monkeypatch):
    frame, image = LiveRenderer.frame, np.ones(8 * MEBIBYTE, dtype=np.uint8)

    def copying(self, *args):
        image.copy()
        return frame(self, *args)

    monkeypatch.setattr(LiveRenderer, "frame", copying)
    for row, before in zip(measure((48, 32)), rows, strict=False):
        expected = image.nbytes if row["live"] else 0
        assert abs(row["host_bytes"] - before["host_bytes"] - expected) < MEBIBYTE, row


def host_bytes(renderer: Renderer, side: int, mode: FoveaMode, spp: int) -> tuple[int, int]:
    """Most bytes of a moving frame that pass through the host, and of a single array of them."""
    camera = renderer.scene.camera.resized(side, side)
    settings = FrameSettings(fov_a=30, fov_b=20, spp=spp, fovea=mode, camera=camera)
    views = [replace(settings, gaze=(0.4 + 0.02 * n, 0.5)) for n in range(4)]
    views += [replace(settings, camera=replace(camera, fx=(1.01 + 0.01 * n) * camera.fx)) for n in range(4)]
    found = []
    for seed, view in enumerate(views):
        with HostBytes() as host:
            renderer.frame(view, seed)
            dr.sync_thread()
        found.append((host.count, host.largest))
    # The first frames of each kind load and compile.
    counts, largest = zip(*found[2:4], *found[6:], strict=True)
    return max(counts), max(largest)


def bytes_of_more_pixels(renderer: Renderer, mode: FoveaMode, spp: int) -> tuple[int, int]:
    """By how much these are more in a frame of LARGE pixels a side than in one of SMALL."""
    smaller, larger = (host_bytes(renderer, side, mode, spp) for side in (SMALL, LARGE))
    return larger[0] - smaller[0], larger[1] - smaller[1]


@pytest.fixture(scope="module", params=[Renderer, LiveRenderer])
def renderer(request, scene, forest) -> Renderer:
    return request.param(scene, forest)


@pytest.mark.parametrize("spp", [1, 4])
@pytest.mark.parametrize("mode", FoveaMode)
def test_no_pass_brings_an_image_to_the_host(renderer, mode, spp):
    """Only what there is per tile and per row, no array of which has a byte for every eight pixels."""
    count, largest = bytes_of_more_pixels(renderer, mode, spp)
    assert largest < LARGE**2 / 8
    # Of all arrays together, most of them copies of each other.
    assert count < IMAGE / 2


@pytest.mark.parametrize("kind", [Renderer, LiveRenderer])
def test_what_the_forest_does_not_know_is_filled_on_the_device(scene, forest, kind):
    elsewhere = replace(
        scene.camera, world_to_camera=np.diag([-1.0, 1, -1, 1]) @ scene.camera.world_to_camera
    )
    renderer = kind(scene, attach_views(forest, [elsewhere]))
    assert renderer.frame(FrameSettings(camera=scene.camera.resized(SMALL, SMALL))).filled == 1
    count, largest = bytes_of_more_pixels(renderer, FoveaMode.FUSED, 1)
    assert largest < LARGE**2 / 8
    assert count < IMAGE / 2


@pytest.mark.parametrize("channels", [1, 3])
def test_a_pass_that_computes_with_numpy_is_seen(scene, forest, monkeypatch, channels):
    blend = module.blend

    def on_the_host(*args):
        image, behind = blend(*args)
        assert (2 * image.numpy()[..., :channels] >= 0).all()
        return image, behind

    monkeypatch.setattr(module, "blend", on_the_host)
    count, largest = bytes_of_more_pixels(Renderer(scene, forest), FoveaMode.RAW, 1)
    assert largest > LARGE**2 / 8
    assert count > channels * IMAGE / 3


def test_all_that_numpy_allocates_counts_and_nothing_afterwards():
    values = np.ones(MEBIBYTE, dtype=np.uint8)
    with HostBytes() as host:
        _ = values[1:].reshape(-1)
    assert host.count < 1000
    with HostBytes() as host:
        _ = values + values
        _ = np.zeros((2, MEBIBYTE), dtype=np.uint8)
        grown = np.empty(1, dtype=np.uint8)
        grown.resize(MEBIBYTE, refcheck=False)
    counted = host.count
    assert 4 * MEBIBYTE <= counted < 4 * MEBIBYTE + 1000
    assert host.largest == 2 * MEBIBYTE
    # Memory from then is released, and moved, as any other.
    grown.resize(2 * MEBIBYTE, refcheck=False)
    del grown
    assert values.copy().sum() == MEBIBYTE
    assert host.count == counted


def test_arrays_that_a_device_sends_to_the_host_count(arrays):
    own = dr.backend_v(arrays.plain.Float)
    other = dr.JitBackend.CUDA if own == dr.JitBackend.LLVM else dr.JitBackend.LLVM
    array = dr.arange(arrays.ad.Float, 1000)
    with HostBytes(own) as remote:
        assert array.numpy()[7] == 7
    assert 4000 <= remote.count < 5000
    assert remote.largest == 4000
    with HostBytes(own) as remote:
        assert np.asarray(array)[7] == 7
    assert remote.count >= 4000
    with HostBytes(other) as local:
        assert array.numpy()[7] == 7
    assert local.largest <= local.count < 1000


def test_a_mistake_inside_leaves_numpy_and_drjit_as_they_were(arrays):
    method, handler = dr.ArrayBase.numpy, np.ones(1)
    with pytest.raises(ZeroDivisionError), HostBytes() as host:
        1 / 0  # noqa: B018
    counted = host.count
    assert dr.ArrayBase.numpy is method
    np.ones(MEBIBYTE)
    assert host.count == counted
    assert handler.sum() == 1


def test_a_frame_takes_few_launches(rows):
    """Each costs the host as much as a small frame's kernel, whichever the size of the frame."""
    for row in rows:
        assert row["launches"] <= MOST_LAUNCHES[FoveaMode(row["mode"])], row
