"""Videos along a gaze trace: as many frames as the trace is long, the disc where the trace looks."""

from __future__ import annotations

import signal
from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import MOST_SEED, UserError
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.render import video as module
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.video import render_video
from pathtrace.scene.scene import Scene, load_scene
from tests import small
from tests.hybrid.forests import white_dot
from tests.moving import moving_corner

av = pytest.importorskip("av", reason="videos require PyAV")
TRACE = GazeTrace((0.0, 0.5, 1.0), (Gaze(0.25, 0.5), Gaze(0.75, 0.5), Gaze(0.75, 0.5)))
IDENTITY = {"of": "this test"}
PASSES = ["region", "detail", "splat", "fill", "trace", "fovea", "blend", "total"]


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def settings(scene) -> FrameSettings:
    return FrameSettings(
        fov_a=30, fov_b=30, spp=1, fovea="raw", fill=False, camera=scene.camera.resized(64, 48)
    )


def rendered(scene, settings, path, trace=TRACE, fps=8, seed=0, identity=IDENTITY, progress=None):
    """Renders a video with a renderer that knows nothing of earlier ones."""
    renderer = Renderer(scene, white_dot((0, 0, 1)), history=True)
    noted = progress or (lambda done, total: None)
    return render_video(path, renderer, settings, trace, fps, seed, identity, noted)


def luma(video) -> np.ndarray:
    """(N, H, W) of all frames."""
    with av.open(str(video)) as opened:
        return np.stack([frame.to_ndarray(format="gray") for frame in opened.decode(video=0)]).astype(float)


def test_a_video_follows_the_gaze_at_its_rate(scene, settings, tmp_path):
    steps = []
    times = rendered(
        scene, settings, tmp_path / "a.mp4", progress=lambda done, total: steps.append((done, total))
    )
    assert [list(row) for row in times] == [PASSES] * 8
    assert steps == [(number, 8) for number in range(9)]
    with av.open(str(tmp_path / "a.mp4")) as opened:
        stream = opened.streams.video[0]
        assert (stream.width, stream.height, float(stream.average_rate)) == (64, 48, 8)
    frames = luma(tmp_path / "a.mp4")
    # Splats are black but for a dot; the scene is bright where the viewer looks.
    left, right = frames[:, 18:30, 10:22].mean(axis=(1, 2)), frames[:, 18:30, 42:54].mean(axis=(1, 2))
    assert (left[:4] > 50).all()
    assert (right[4:] > 50).all()
    assert max(left[4:].max(), right[:4].max()) < 20
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(("duration", "count"), [(0.0, 1), (0.1, 1), (0.19, 2), (0.5, 4)])
def test_a_video_is_as_long_as_its_trace(scene, settings, tmp_path, duration, count):
    trace = GazeTrace((0.0, duration), (Gaze(), Gaze()))
    none = replace(settings, fov_a=0, fov_b=0)
    assert len(rendered(scene, none, tmp_path / "a.mp4", trace)) == count
    assert len(luma(tmp_path / "a.mp4")) == count


def test_a_history_makes_a_still_gaze_better(scene, settings, tmp_path):
    still = GazeTrace((0.0, 1.0), (Gaze(), Gaze()))
    rendered(scene, settings, tmp_path / "a.mp4", still, fps=16)
    disc = luma(tmp_path / "a.mp4")[:, 18:30, 26:38]
    steps = np.abs(np.diff(disc, axis=0)).mean(axis=(1, 2))
    assert steps[-4:].mean() < 0.5 * steps[:2].mean()


def test_an_interrupted_video_resumes_to_the_same_end(scene, settings, tmp_path):
    rendered(scene, settings, tmp_path / "whole.mp4")

    def interrupt(done: int, total: int) -> None:
        if done == 4:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        rendered(scene, settings, tmp_path / "parts.mp4", progress=interrupt)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["parts.mp4.frames", "whole.mp4"]
    with pytest.raises(UserError, match=r"for other inputs \(of\)"):
        rendered(scene, settings, tmp_path / "parts.mp4", identity={"of": "another test"})
    steps = []
    times = rendered(scene, settings, tmp_path / "parts.mp4", progress=lambda done, total: steps.append(done))
    assert steps == [5, 6, 7, 8]
    assert len(times) == 8
    # The fovea's history is part of what the video resumes from.
    np.testing.assert_array_equal(luma(tmp_path / "parts.mp4"), luma(tmp_path / "whole.mp4"))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["parts.mp4", "whole.mp4"]


def test_a_video_that_is_interrupted_while_it_is_encoded_renders_nothing_again(
    scene, settings, tmp_path, monkeypatch
):
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(module, "write_mp4", interrupted)
        with pytest.raises(KeyboardInterrupt):
            rendered(scene, settings, tmp_path / "a.mp4")
    with monkeypatch.context() as patched:
        patched.setattr(Renderer, "frame", interrupted)
        assert len(rendered(scene, settings, tmp_path / "a.mp4")) == 8
    assert len(luma(tmp_path / "a.mp4")) == 8


def test_each_frame_has_a_seed_of_its_own(scene, settings, tmp_path, monkeypatch):
    seeds, original = [], Renderer.frame

    def noting(self, settings, seed):
        seeds.append(seed)
        return original(self, settings, seed)

    monkeypatch.setattr(Renderer, "frame", noting)
    rendered(scene, replace(settings, fov_a=0, fov_b=0), tmp_path / "a.mp4", fps=4, seed=100)
    assert seeds == [100, 101, 102, 103]


def test_a_video_of_too_many_frames_is_refused_before_any_is_rendered(scene, settings, tmp_path):
    day = GazeTrace((0.0, 86_400.0), (Gaze(), Gaze()))
    with pytest.raises(UserError, match=r"^86400 s at 30 frames per second: must be 999999 frames at most$"):
        rendered(scene, settings, tmp_path / "a.mp4", day, fps=30)
    assert not list(tmp_path.iterdir())


def test_seeds_of_a_video_stay_seeds(scene, settings, tmp_path):
    """The frame after the one with the largest seed has the least."""
    short = GazeTrace((0.0, 0.25), (Gaze(), Gaze()))
    assert len(rendered(scene, settings, tmp_path / "a.mp4", short, seed=MOST_SEED)) == 2
    with pytest.raises(UserError, match=r"^seed -1: must be a whole number"):
        rendered(scene, settings, tmp_path / "b.mp4", short, seed=-1)


def test_a_scene_that_moves_plays(tmp_path, settings):
    """A lap takes a second: the frames of the second lap are those of the first."""
    scene = moving_corner(tmp_path)
    whole = replace(settings, fov_a=200, fov_b=200, time=0.25, spp=64)
    folder = tmp_path / "video"
    folder.mkdir()
    trace = GazeTrace((0.0, 2.0), (Gaze(), Gaze()))
    rendered(scene, whole, folder / "a.mp4", trace, fps=4)
    frames = luma(folder / "a.mp4")
    alike = [np.abs(frames[number] - frames[number + 4]).mean() for number in range(4)]
    apart = [np.abs(frames[number] - frames[number + 1]).mean() for number in range(3)]
    assert min(apart) > 1.5 * max(alike)
