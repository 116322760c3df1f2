"""What methods know of a gaze, and how they are judged for it."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import AngularTrace, Gaze, GazeTrace
from hybrid.base.cache_folder import scene_folder
from hybrid.evaluation import gaze_bench as module
from hybrid.evaluation.gaze_bench import (
    STILL,
    SVGF,
    TAA,
    Clips,
    Tracking,
    bench_gaze,
    starts_of,
    trace_of,
)
from hybrid.evaluation.moving_bench import HYBRID, SPLATS, TRACED
from hybrid.measure.perceptual_metrics import jod_of_video
from hybrid.render.frame_settings import INTERACTIVE
from tests import small

DISPLAY = Display(48, 32, 40.0)
SETTINGS = replace(INTERACTIVE, display=DISPLAY)
CLIPS = Clips(2, 0.3, 10, 8)
# Half a second to the left, then to the right.
TRACE = GazeTrace((0.0, 1.5, 4.0), (Gaze(0.25, 0.5), Gaze(0.75, 0.25), Gaze(0.75, 0.25)))


def silent(done: int, total: int) -> None:
    pass


def test_a_late_gaze_is_that_of_before():
    late = Tracking(100, 0)
    assert late.at(TRACE, 1.55, DISPLAY, 0) == TRACE.gazes[0]
    assert late.at(TRACE, 1.61, DISPLAY, 0) == TRACE.gazes[1]
    assert late.at(TRACE, 0.05, DISPLAY, 0) == TRACE.gazes[0]


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("display", [DISPLAYS["hmd"], DISPLAY])
def test_a_tracker_is_wrong_by_as_many_degrees_in_the_mean_square(seed, display):
    """In the three seconds of a turn; most of it stays."""
    gaze = Gaze(0.7, 0.4)
    trace, size = GazeTrace((0.0,), (gaze,)), np.array([display.width, display.height])

    def angles(gazes: list[Gaze]) -> np.ndarray:
        offsets = (np.array([[one.x, one.y] for one in gazes]) - 0.5) * size / display.focal
        return np.degrees(np.arctan(offsets))

    seconds = np.linspace(0, 3, 300, endpoint=False)
    for degrees in (1.0, 3.0):
        known = [Tracking(0, degrees).at(trace, second, display, seed) for second in seconds]
        errors = angles(known) - angles([gaze])
        assert np.sqrt((errors**2).sum(axis=1).mean()) == pytest.approx(degrees, rel=1e-6)
        assert np.linalg.norm(errors.mean(axis=0)) == pytest.approx(0.8 * degrees, rel=1e-6)
        # Slow: half a degree in a frame would be noise.
        assert np.linalg.norm(np.diff(errors, axis=0), axis=1).max() < 0.02 * degrees
    assert known != [Tracking(0, 3.0).at(trace, second, display, seed + 1) for second in seconds]


def test_no_error_leads_behind_the_viewer():
    wide = Display(100, 100, 170.0)
    edge = GazeTrace((0.0,), (Gaze(1.0, 0.0),))
    for second in np.linspace(0, 3, 20):
        gaze = Tracking(0, 45).at(edge, float(second), wide, 0)
        assert np.isfinite([gaze.x, gaze.y]).all()


def test_clips_are_all_over_the_trace_behind_what_is_seen_late():
    starts = starts_of(TRACE, Clips(3, 0.5, 10, 8), 0.1)
    # Eight frames before the first one, and five of the last one.
    np.testing.assert_allclose(starts, [0.9, 2.2, 3.5])
    assert starts_of(TRACE, Clips(1, 0.5, 10, 8), 0.0) == [0.8]


def test_a_recorded_trace_is_shown_on_the_display_and_must_last():
    angles = AngularTrace((0.0, 2.0), ((0.0, 0.0), (20.0, 0.0)))
    found = trace_of(angles, CLIPS, 0.1, DISPLAY)
    # The display's edge is 20 degrees aside.
    assert found.gazes[1].x == pytest.approx(1.0)
    with pytest.raises(UserError, match=r"gaze trace of 2 s: must be of 2\.20 s at least"):
        trace_of(angles, CLIPS, 1.1, DISPLAY)


def test_the_simulated_viewer_looks_long_enough():
    for clips in (CLIPS, Clips(5, 2.0, 24, 8)):
        trace = trace_of(None, clips, 0.5, DISPLAY)
        assert trace == trace_of(None, clips, 0.5, DISPLAY)
        starts = starts_of(trace, clips, 0.5)
        assert len(starts) == clips.count
        assert min(np.diff(starts)) > clips.frames / clips.fps
        assert starts[-1] + clips.frames / clips.fps <= trace.duration + 1e-9


def test_the_fovea_is_judged_around_each_gaze(monkeypatch):
    """The frames' columns are numbered; ten degrees are 12 pixels."""
    truth = np.broadcast_to(np.arange(48, dtype=np.float32)[None, :, None], (32, 48, 3))
    seen = []

    def judged(image, expected, display, gaze):
        seen.append((image[0, 0, 0], image.shape, round(gaze.x * image.shape[1], 6), gaze.y))
        return float(expected[0, 0, 0])

    monkeypatch.setattr(module, "jod", judged)
    gazes = [Gaze(0.5, 0.5), Gaze(0.0, 0.5), Gaze(1.25, 0.5)]
    found = module.foveal_jod([truth] * 3, [truth + 1] * 3, gazes, DISPLAY)
    # Beside the frame, the square stays within it.
    assert seen == [(18, (12, 12, 3), 6, 0.5), (0, (12, 12, 3), 0, 0.5), (36, (12, 12, 3), 24, 0.5)]
    assert found == pytest.approx(1 + (18 + 0 + 36) / 3)


def rows_of(corner, rough, clips=CLIPS, trace=TRACE, tracked=((50,), (0, 3)), write=lambda rows: None):
    return bench_gaze(corner, rough, SETTINGS, clips, trace, tracked, write, silent)


@pytest.fixture
def no_jod(monkeypatch):
    """JOD by what was shown alone, for it takes longest."""

    def error(images, truths, rate, display, gazes):
        assert len(images) == len(truths) == len(gazes)
        pairs = zip(images, truths, strict=True)
        return 10 - float(np.mean([np.abs(one - other).mean() for one, other in pairs]))

    monkeypatch.setattr(module, "jod_of_video", error)
    monkeypatch.setattr(module, "jod", lambda image, truth, *_: error([image], [truth], 0, None, [None]))


@pytest.mark.usefixtures("own_home", "no_jod")
def test_what_follows_the_gaze_has_a_row_for_each_tracking(corner, rough):
    rows = rows_of(corner, rough)
    found = {(row["method"], row["latency_ms"], row["gaze_error_deg"]): row for row in rows}
    pairs = [(50, 0), (50, 3)]
    assert set(found) == {(name, *pair) for name in (HYBRID, STILL) for pair in pairs} | {
        (name, None, None) for name in (SPLATS, TRACED, TAA, SVGF)
    }
    assert all(row["low"] <= row["jod"] <= row["high"] for row in rows)
    assert all(np.mean(row["foveal_jod_by_clip"]) == pytest.approx(row["foveal_jod"]) for row in rows)
    assert all(row["ms"] > 0 and (row["clips"], row["frames"]) == (2, 3) for row in rows)
    # Rough splats stand still, single paths do not.
    assert found[SPLATS, None, None]["flicker"] == pytest.approx(0, abs=1e-9)
    assert found[TAA, None, None]["flicker"] > 0
    # The renderer's fovea is elsewhere.
    assert found[STILL, 50, 0]["foveal_jod"] != found[STILL, 50, 3]["foveal_jod"]
    # What splats get wrong is path-traced.
    assert found[SPLATS, None, None]["jod"] < found[HYBRID, 50, 0]["jod"] < found[SVGF, None, None]["jod"]


@pytest.mark.usefixtures("own_home", "no_jod")
def test_an_interrupted_bench_goes_on_where_it_was(corner, rough, monkeypatch):
    clips, tracked, judged = Clips(1, 0.2, 10, 8), ((0,), (0,)), []
    whole = module._Bench.judged

    def until(self, name, *given):
        if name == TAA and not judged.count(TAA):
            judged.append(name)
            raise KeyboardInterrupt
        judged.append(name)
        return whole(self, name, *given)

    monkeypatch.setattr(module._Bench, "judged", until)
    with pytest.raises(KeyboardInterrupt):
        rows_of(corner, rough, clips, tracked=tracked)
    stored = list(scene_folder(corner.name, corner.hash).glob("gaze-*.json"))
    assert len(stored) == 1
    written = []
    rows = rows_of(corner, rough, clips, tracked=tracked, write=written.append)
    assert written == [rows]
    assert judged == [HYBRID, STILL, SPLATS, TRACED, TAA, TAA, SVGF]
    assert not stored[0].exists()
    # One clip has no interval.
    assert [(row["low"], row["high"]) for row in rows] == [(None, None)] * 6


@pytest.mark.usefixtures("own_home")
def test_a_walk_has_a_view_and_a_reference_for_each_frame_and_eye(corner, rough, monkeypatch):
    clips = Clips(1, 0.3, 10, 8, walks=True, both_eyes=True)
    bench = module._Bench(corner, rough, SETTINGS, clips, TRACE)
    left, right = bench._eyes(0.9)
    assert len(left) == len(right) == 11
    assert len({*left, *right}) == 22
    apart = [np.linalg.norm(one.position - other.position) for one, other in zip(left, right, strict=True)]
    np.testing.assert_allclose(apart, bench._near.scale / 64, rtol=1e-5)
    steps = np.linalg.norm(np.diff([camera.position for camera in left], axis=0), axis=1)
    assert 0 < steps.max() < 0.05 * bench._near.scale
    seen = []

    def shown(images, truths, rate, display, gazes):
        seen.append((images, truths))
        return float(len(seen))

    monkeypatch.setattr(module, "jod_of_video", shown)
    monkeypatch.setattr(module, "jod", lambda *_: None)
    result = bench.judged(SVGF, None, 0, 0.9)
    assert (result["jod"], result["foveal_jod"]) == (1.5, None)
    assert len(result["ms"]) == 6
    assert len({truth.tobytes() for _, truths in seen for truth in truths}) == 6


@pytest.mark.usefixtures("own_home")
def test_nobody_walks_where_there_is_no_space(corner, rough, monkeypatch):
    monkeypatch.setattr(module.Neighbourhood, "path", lambda self, shares: [self.home for _ in shares])
    with pytest.raises(UserError, match="no free space to walk in"):
        module._Bench(corner, rough, SETTINGS, replace(CLIPS, walks=True), TRACE)


def test_the_longer_the_gaze_rests_on_a_defect_the_worse_it_is():
    if find_spec("pyfvvdp") is None:
        pytest.skip("FovVideoVDP is not installed")
    display, truth = Display(160, 96, 40.0), np.full((96, 160, 3), 0.4, np.float32)
    defect = truth.copy()
    defect[40:56, 8:24] *= small.rng().uniform(0.8, 1.2, (16, 16, 1)).astype(np.float32)

    def score(gazes: Gaze | list[Gaze]) -> float | None:
        return jod_of_video([defect] * 4, [truth] * 4, 24, display, gazes)

    on, off = Gaze(0.1, 0.5), Gaze(0.9, 0.5)
    scores = [score([on] * frames + [off] * (4 - frames)) for frames in (4, 2, 0)]
    assert scores == sorted(scores)
    assert scores[2] - scores[1] > 0.05 < scores[1] - scores[0]
    assert [scores[0], scores[2]] == [score(on), score(off)]
    with pytest.raises(ValueError, match="3 gazes for 4 images"):
        score([on] * 3)
