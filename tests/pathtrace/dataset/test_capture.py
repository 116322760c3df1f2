"""Captures: complete, resumable, and never mixed with another."""

from __future__ import annotations

import hashlib
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.coordinate_systems import camera_from_json
from pathtrace.dataset.capture import capture, chosen_capture, join_shares, render_share
from pathtrace.dataset.captured_frames import CapturedFrame, read_frame, write_frame
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet, read_frame_set
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace import Integrator
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.moving import moving_corner

SETTINGS = CaptureSettings(views=4, held_out=2, width=24, height=16, spp=2, held_out_spp=4)
# Four views of 2 samples and two of 4.
SAMPLES = 24 * 16 * (4 * 2 + 2 * 4)


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory) -> tuple[FrameSet, list[tuple[int, int]]]:
    """A capture without interruption, and the progress that it reported."""
    reported: list[tuple[int, int]] = []
    frames = capture(scene, tmp_path_factory.mktemp("whole"), SETTINGS, lambda *args: reported.append(args))
    return frames, reported


def contents(folder: Path) -> dict[str, str]:
    """Hash of each file of a frame set by its name."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


class InterruptError(Exception):
    pass


def interrupt(done: int, total: int) -> None:
    if done > total / 2:
        raise InterruptError


def test_a_capture_is_a_complete_frame_set(scene, whole):
    frames, _ = whole
    assert (frames.scene_name, frames.scene_hash) == (scene.name, scene.hash)
    assert [entry.samples for entry in frames.training] == [2] * 4
    assert [entry.samples for entry in frames.held_out] == [4] * 2
    # The frames and the description.
    assert len(contents(frames.folder)) == 6 + 1
    for entry in frames.entries:
        frame = read_frame(entry.file)
        assert frame.radiance.shape == (entry.camera.height, entry.camera.width, 3)
        assert np.isfinite(frame.radiance).all()
    assert frames.integrator == "path"
    assert frames == read_frame_set(frames.folder)


def test_progress_counts_samples(whole):
    """After each of the six frames, up to all of them."""
    _, reported = whole
    done, totals = zip(*reported, strict=True)
    assert set(totals) == {SAMPLES}
    assert len(done) == 6
    assert done[0] == 24 * 16 * 2
    assert done[-1] == SAMPLES
    assert all(later > earlier for earlier, later in pairwise(done))


def test_paths_of_all_but_held_out_frames_end_in_a_cache_if_there_is_one(scene, whole, tmp_path):
    """Held-out frames are unbiased with and without."""
    cache = fill_cache(scene, [scene.camera], points=4096)
    frames = capture(scene, tmp_path, SETTINGS, lambda done, total: None, cache)
    assert frames.integrator == "cached"
    for one, other in zip(whole[0].entries, frames.entries, strict=True):
        same = np.array_equal(read_frame(one.file).radiance, read_frame(other.file).radiance)
        assert same == one.held_out


def test_an_interrupted_capture_ends_with_the_same_files(scene, whole, tmp_path):
    with pytest.raises(InterruptError):
        capture(scene, tmp_path, SETTINGS, interrupt)
    with pytest.raises(UserError, match="files are missing"):
        read_frame_set(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.exr")}
    capture(scene, tmp_path, SETTINGS, lambda done, total: None)
    assert contents(tmp_path) == contents(whole[0].folder)
    # What was there has not been rendered again.
    assert before
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_another_seed_gives_other_frames(scene, whole, tmp_path):
    settings = CaptureSettings(**{**SETTINGS.__dict__, "seed": 1})
    frames = capture(scene, tmp_path, settings, lambda done, total: None)
    first, other = (read_frame(f.training[0].file).radiance for f in (whole[0], frames))
    # The scene's own camera both times, with other noise.
    assert frames.training[0].camera.key == whole[0].training[0].camera.key
    assert not np.array_equal(first, other)


@extreme(
    "fields of view of captured frames",
    given="1 to 179 degrees, in a wide frame, around a camera of 60 degrees",
    expected="that of all frames, around the scene's own camera",
)
@pytest.mark.parametrize("fov", [1, 90, 179])
def test_frames_have_the_field_of_view_that_is_asked_for(scene, fov, got):
    settings = CaptureSettings(views=4, held_out=2, width=32, height=16, fov=fov)
    document = chosen_capture(scene, settings, Integrator.PATH)
    assert document["settings"]["fov"] == fov
    cameras = [camera_from_json({**document, **entry}) for entry in document["frames"]]
    np.testing.assert_allclose(cameras[0].world_to_camera, scene.camera.world_to_camera, atol=1e-12)
    for camera in cameras:
        edges = camera.rays(np.array([[0, 8], [32, 8.0]]))
        assert got(np.degrees(np.arccos(edges[0] @ edges[1]))) == pytest.approx(fov, rel=1e-4)
        assert camera.fx == camera.fy


def test_another_capture_is_not_overwritten(scene, whole):
    before = contents(whole[0].folder)
    settings = CaptureSettings(views=3, held_out=1, width=24, height=16, spp=2)
    with pytest.raises(UserError, match="holds another capture"):
        capture(scene, whole[0].folder, settings, lambda done, total: None)
    assert contents(whole[0].folder) == before


def damages(content: bytes) -> dict[str, bytes | None]:
    """A file that is missing, cut off, of zeros, or with a flipped bit among its values."""
    flipped = bytearray(content)
    flipped[-20] ^= 0x10
    return {
        "missing": None,
        "empty": b"",
        "cut": content[: len(content) // 2],
        "last byte": content[:-1],
        "zeros": bytes(len(content)),
        "flipped": bytes(flipped),
    }


@extreme(
    "damaged captures",
    given="frames missing, cut off, zeroed, with a flipped bit, or another one's",
    expected="exactly the damaged files rendered again, the same bytes as before",
)
def test_a_capture_repairs_exactly_what_is_damaged(scene, whole, tmp_path, got):
    shutil.copytree(whole[0].folder, tmp_path / "c")
    folder, expected = tmp_path / "c", contents(whole[0].folder)
    files = [folder / "frames" / f"{name}.exr" for name in ("0000", whole[0].held_out[0].file.stem)]
    repaired = 0
    for kind in damages(b"x" * 40):
        for file in files:
            damaged = damages(file.read_bytes())[kind]
            file.unlink() if damaged is None else file.write_bytes(damaged)
        before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.exr") if path not in files}
        capture(scene, folder, SETTINGS, lambda done, total: None)
        assert contents(folder) == expected, kind
        assert {path: path.stat().st_mtime_ns for path in before} == before
        repaired += len(files)
    # Of another size, and with other channels.
    frame = read_frame(files[0])
    smaller = CapturedFrame(**{name: image[:8] for name, image in vars(frame).items()})
    for other in (smaller, frame.radiance):
        write_frame(files[0], other)
        capture(scene, folder, SETTINGS, lambda done, total: None)
        assert contents(folder) == expected
        repaired += 1
    got(f"{repaired} of {repaired} files repaired")


def test_a_damaged_description_is_refused_with_advice(scene, whole, tmp_path):
    shutil.copytree(whole[0].folder, tmp_path / "c")
    description = tmp_path / "c" / "transforms.json"
    description.write_bytes(description.read_bytes()[:-3] + b"\xff")
    with pytest.raises(
        UserError, match=r"transforms\.json: is damaged .*; delete it and capture with the same"
    ):
        capture(scene, tmp_path / "c", SETTINGS, lambda done, total: None)


def test_views_of_a_scene_that_moves_show_their_own_times(tmp_path):
    scene = moving_corner(tmp_path)
    frames = capture(scene, tmp_path / "frames", SETTINGS, lambda done, total: None)
    assert [course.name for course in frames.courses] == ["board"]
    assert len({entry.time for entry in frames.entries}) == 6
    tracer, shown = Tracer(scene), 0
    for entry in frames.entries:
        scene.set_time(entry.time)
        shape = tracer.hits(entry.camera, frame_positions(entry.camera)).shape
        np.testing.assert_array_equal(read_frame(entry.file).shape.ravel(), shape)
        shown += bool((shape == frames.courses[0].shape).any())
    assert shown > 3


def test_costly_frames_are_dealt_out_evenly(scene, tmp_path):
    """Held-out views come at regular intervals: every second one would be in one of two shares."""
    settings = CaptureSettings(views=5, held_out=4, width=24, height=16, spp=2, held_out_spp=64)
    document, totals = chosen_capture(scene, settings, Integrator.PATH), []

    def note(done: int, total: int) -> None:
        totals.append(total)
        raise InterruptError

    for share in (0, 1):
        with pytest.raises(InterruptError):
            render_share(
                scene,
                tmp_path / str(share),
                document,
                note,
                takes=lambda number, share=share: number % 2 == share,
            )
    assert max(totals) < 1.2 * min(totals)


def test_shares_of_different_captures_are_not_joined(scene, tmp_path):
    shares = [tmp_path / "a", tmp_path / "b"]
    for seed, share in enumerate(shares):
        settings = CaptureSettings(**{**SETTINGS.__dict__, "seed": seed})
        document = chosen_capture(scene, settings, Integrator.PATH)
        render_share(scene, share, document, lambda done, total: None, takes=lambda number: False)
    with pytest.raises(UserError, match=r"b: holds another capture than .*a$"):
        join_shares(tmp_path / "whole", shares)
    assert not (tmp_path / "whole").exists()
