"""Films along a gaze trace: frames as many as the trace is long, the disc where the trace looks."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace
from tests.hybrid.command import run

av = pytest.importorskip("av", reason="films need PyAV")


@pytest.fixture
def trace(tmp_path):
    file = tmp_path / "gaze.csv"
    GazeTrace((0.0, 0.5, 1.0), (Gaze(0.25, 0.5), Gaze(0.75, 0.5), Gaze(0.75, 0.5))).save(file)
    return file


def pictures(film):
    """(N, H, W) luma of all frames."""
    with av.open(str(film)) as opened:
        return np.stack([frame.to_ndarray(format="gray") for frame in opened.decode(video=0)])


def test_a_film_follows_the_gaze(made, monkeypatch, tmp_path, trace):
    film = tmp_path / "a.mp4"
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace, "--fps", 8]
    size = ["--size", 96, 64, "--spp", 1, "--fovea", "raw", "--fov-a", 30, "--fov-b", 30]
    assert run(monkeypatch, *common, *size, "-o", film, "--json", tmp_path / "a.json") == 0
    with av.open(str(film)) as opened:
        stream = opened.streams.video[0]
        assert (stream.width, stream.height, float(stream.average_rate)) == (96, 64, 8)
    frames = pictures(film).astype(float)
    assert len(frames) == 8
    # Raw samples are noisy, splats are not: the noise is where the viewer looks.
    left, right = np.s_[20:44, 14:34], np.s_[20:44, 62:82]
    noise = [[np.abs(np.diff(frame[side], axis=1)).mean() for side in (left, right)] for frame in frames]
    assert noise[0][0] > noise[-1][0]
    assert noise[-1][1] > noise[0][1]


def test_a_film_without_a_rate_has_30_frames_per_second(made, monkeypatch, tmp_path):
    GazeTrace((0.0, 0.1), (Gaze(), Gaze())).save(tmp_path / "short.csv")
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", tmp_path / "short.csv"]
    size = ["--size", 32, 32, "--spp", 1, "--fovea", "raw"]
    assert run(monkeypatch, *common, *size, "-o", tmp_path / "a.mp4", "--json", tmp_path / "a.json") == 0
    row = json.loads((tmp_path / "a.json").read_text())
    assert (row["fps"], len(row["frames"])) == (30, 3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["-o", "a.png"], "must end in .mp4"),
        (["-o", "a.mp4", "--size", "33", "32"], "must be even"),
        (["-o", "a.mp4", "--detail", "d.png"], "--detail"),
        (["-o", "a.mp4", "--gaze", "0.5", "0.5"], "--gaze, --gaze-trace: the gaze can only come from one"),
    ],
)
def test_what_makes_no_film_is_refused_by_name(made, monkeypatch, tmp_path, trace, capsys, options, said):
    monkeypatch.chdir(tmp_path)
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace]
    assert run(monkeypatch, *common, *options) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*a.mp4*"))


def test_an_interrupted_film_goes_on_to_the_same_end(made, monkeypatch, tmp_path, trace, capsys):
    from hybrid.frame.renderer import HybridRenderer

    whole, parts = tmp_path / "whole.mp4", tmp_path / "parts.mp4"
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace, "--fps", 8]
    common += ["--size", 64, 48, "--spp", 1]
    assert run(monkeypatch, *common, "-o", whole, "--json", tmp_path / "whole.json") == 0
    render, rendered = HybridRenderer.frame, []

    def interrupted(self, *arguments):
        if len(rendered) == 5:
            raise KeyboardInterrupt
        rendered.append(render(self, *arguments))
        return rendered[-1]

    with monkeypatch.context() as patched:
        patched.setattr(HybridRenderer, "frame", interrupted)
        assert run(monkeypatch, *common, "-o", parts) != 0
    assert not parts.exists()
    assert run(monkeypatch, *common, "-o", parts, "--seed", 9) == 2
    assert "another seed" in capsys.readouterr().err
    assert run(monkeypatch, *common, "-o", parts, "--json", tmp_path / "parts.json") == 0
    first, second = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("whole", "parts"))
    assert len(first["frames"]) == len(second["frames"]) == 8
    # What the fovea remembered is part of what goes on.
    assert (pictures(parts) == pictures(whole)).all()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "gaze.csv",
        "parts.json",
        "parts.mp4",
        "whole.json",
        "whole.mp4",
    ]


def test_a_film_interrupted_while_it_is_encoded_renders_nothing_again(made, monkeypatch, tmp_path, trace):
    from hybrid.frame.renderer import HybridRenderer
    from hybrid.video import video

    film = tmp_path / "a.mp4"
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace, "--fps", 8]
    common += ["--size", 64, 48, "--spp", 1, "-o", film]

    def interrupted(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(video, "_encode", interrupted)
        assert run(monkeypatch, *common) != 0
    assert not film.exists()
    with monkeypatch.context() as patched:
        patched.setattr(HybridRenderer, "frame", interrupted)
        assert run(monkeypatch, *common) == 0
    assert len(pictures(film)) == 8
