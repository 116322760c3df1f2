"""Films along a gaze trace: frames as many as the trace is long, the disc where the trace looks."""

from __future__ import annotations

import numpy as np
import pytest

from compose.gaze_trace import GazeTrace
from compose.view import Gaze
from tests.hybrid.command import run

av = pytest.importorskip("av", reason="films need PyAV")


@pytest.fixture
def trace(tmp_path):
    file = tmp_path / "gaze.csv"
    GazeTrace((0.0, 0.5, 1.0), (Gaze(0.25, 0.5), Gaze(0.75, 0.5), Gaze(0.75, 0.5))).save(file)
    return file


def test_a_film_follows_the_gaze(made, monkeypatch, tmp_path, trace):
    film = tmp_path / "a.mp4"
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace, "--fps", 8]
    size = ["--size", 96, 64, "--spp", 1, "--fovea", "raw", "--fov-a", 30, "--fov-b", 30]
    assert run(monkeypatch, *common, *size, "-o", film, "--json", tmp_path / "a.json") == 0
    with av.open(str(film)) as opened:
        stream = opened.streams.video[0]
        assert (stream.width, stream.height, float(stream.average_rate)) == (96, 64, 8)
        frames = [frame.to_ndarray(format="gray").astype(float) for frame in opened.decode(stream)]
    assert len(frames) == 8
    # Raw samples are noisy, splats are not: the noise is where the viewer looks.
    left, right = np.s_[20:44, 14:34], np.s_[20:44, 62:82]
    noise = [[np.abs(np.diff(frame[side], axis=1)).mean() for side in (left, right)] for frame in frames]
    assert noise[0][0] > noise[-1][0]
    assert noise[-1][1] > noise[0][1]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["-o", "a.png"], "must end in .mp4"),
        (["-o", "a.mp4", "--size", "33", "32"], "must be even"),
        (["-o", "a.mp4", "--detail", "d.png"], "--detail"),
    ],
)
def test_what_makes_no_film_is_refused_by_name(made, monkeypatch, tmp_path, trace, capsys, options, said):
    monkeypatch.chdir(tmp_path)
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace]
    assert run(monkeypatch, *common, *options) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*a.mp4*"))


def test_nothing_is_left_of_a_film_that_was_interrupted(made, monkeypatch, tmp_path, trace):
    from hybrid.renderer import HybridRenderer

    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(HybridRenderer, "frame", interrupted)
    common = ["render", "cornell", "--forest", made / "box.forest", "--gaze-trace", trace]
    assert run(monkeypatch, *common, "--size", 32, 32, "-o", tmp_path / "a.mp4") != 0
    assert not list(tmp_path.glob("*a.mp4*"))
    assert not list(tmp_path.glob(".part*"))
