"""The frames of an unfinished video: what is there after an interruption, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.render import video as module
from hybrid.render.video import VideoFrames
from tests import small
from tests.extremes import extreme

IDENTITY = {"scene": "a", "size": (4, 5), "seed": 0}
IMAGES = small.rng().integers(0, 256, (3, 5, 4, 3), dtype=np.uint8)
HISTORY = {
    "radiance": np.arange(6, dtype=np.float32).reshape(2, 3),
    "gloss": np.array([1, 2], dtype=np.uint8),
}


def never() -> dict:
    raise AssertionError("the history is not to be stored now")


@pytest.fixture
def folder(tmp_path):
    """Three frames, after which the history was stored."""
    frames = VideoFrames(tmp_path / "a.frames", IDENTITY)
    for number, image in enumerate(IMAGES):
        frames.add(image, {"total": float(number)}, never)
    frames.keep(HISTORY)
    return tmp_path / "a.frames"


def test_a_new_video_has_no_frames_and_writes_nothing(tmp_path):
    frames = VideoFrames(tmp_path / "a.frames", IDENTITY)
    assert frames.milliseconds == []
    assert frames.history == {}
    assert list(frames.images()) == []
    assert not list(tmp_path.iterdir())


def test_frames_times_and_history_are_there_again(folder):
    frames = VideoFrames(folder, IDENTITY)
    assert frames.milliseconds == [{"total": 0.0}, {"total": 1.0}, {"total": 2.0}]
    np.testing.assert_array_equal(list(frames.images()), IMAGES)
    found = frames.history
    assert {*found} == {*HISTORY}
    for name, values in HISTORY.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype


def test_a_video_without_a_history_resumes_too(folder):
    frames = VideoFrames(folder, IDENTITY)
    frames.add(IMAGES[0], {"total": 3.0}, never)
    frames.keep({})
    again = VideoFrames(folder, IDENTITY)
    assert again.history == {}
    assert len(again.milliseconds) == 4


def test_frames_after_the_last_stored_history_are_rendered_again(folder):
    frames = VideoFrames(folder, IDENTITY)
    frames.add(IMAGES[0], {"total": 3.0}, never)
    assert len(list(frames.images())) == 4
    again = VideoFrames(folder, IDENTITY)
    assert len(again.milliseconds) == 3
    again.add(IMAGES[2], {"total": 3.0}, never)
    np.testing.assert_array_equal(list(again.images())[3], IMAGES[2])


def test_the_history_is_stored_every_thirty_seconds(tmp_path, monkeypatch):
    now, stored = [100.0], []
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    frames = VideoFrames(tmp_path / "a.frames", IDENTITY)

    def history() -> dict:
        stored.append(now[0])
        return HISTORY

    for seconds in (101.0, 130.0, 130.5, 160.0, 160.6, 190.7):
        now[0] = seconds
        frames.add(IMAGES[0], {"total": 1.0}, history)
    assert stored == [130.5, 160.6, 190.7]
    assert len(VideoFrames(tmp_path / "a.frames", IDENTITY).milliseconds) == 6


def test_a_folder_of_another_video_is_refused(folder):
    message = f"^{folder}: holds the beginning of a video for other inputs \\(seed\\); delete it, or choose"
    with pytest.raises(UserError, match=message):
        VideoFrames(folder, IDENTITY | {"seed": 1})
    assert len(VideoFrames(folder, IDENTITY).milliseconds) == 3


@pytest.mark.parametrize("number", [0, 2])
def test_a_missing_frame_is_noticed(folder, number):
    (folder / f"{number:06}.png").unlink()
    with pytest.raises(UserError, match=f"^{folder}: frames are missing; delete it to start again$"):
        VideoFrames(folder, IDENTITY)


def test_a_damaged_history_is_named(folder):
    (folder / "state.safetensors").write_bytes(b"\xff" * 64)
    with pytest.raises(UserError, match=r"state\.safetensors"):
        VideoFrames(folder, IDENTITY)


def test_a_complete_video_leaves_no_folder(folder):
    VideoFrames(folder, IDENTITY).remove()
    assert not folder.exists()


@extreme(
    "interrupted video, damaged",
    given="a frame cut off, of zeros, with a flipped bit; the history cut off",
    expected="refused in one line that says what to delete",
)
def test_a_video_does_not_resume_from_what_is_damaged(folder, got):
    said = []
    for name in ("000001.png", "state.safetensors"):
        file = folder / name
        whole = file.read_bytes()
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 1
        for content in (b"", whole[:-20], whole[: len(whole) // 2], bytes(len(whole)), bytes(flipped)):
            file.write_bytes(content)
            with pytest.raises(UserError, match=rf"{name}: .*delete .* to start again") as caught:
                VideoFrames(folder, IDENTITY)
            assert str(caught.value).isprintable()
            said.append(caught.value)
        file.write_bytes(whole)
    assert len(VideoFrames(folder, IDENTITY).milliseconds) == 3
    got(f"{len(said)} refused")
