"""What moves: where samples of it are at rest, and what a history keeps of them from moment to moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.traced_samples import ALWAYS, DIFFUSE, GLOSSY, SPECULAR, STILL, UNSTEADY, Moment
from compose.fovea.history import MOST_LATER, History
from tests import small
from tests.compose.arrays_of import PlainSamples, channels, floats, host, indices
from tests.compose.fovea.views import SIZE, camera, random_moment, samples, wall, whole


def shifted(time: float, x: float) -> Moment:
    """One mover, shifted along x."""
    pose = np.eye(4)[:3].copy()
    pose[0, 3] = x
    return Moment(time, np.stack([np.eye(4)[:3], pose]))


@pytest.fixture
def after(arrays):
    """All that a history knows of all pixels after a frame of a moment."""

    def run(history: History, moment: Moment, new: PlainSamples) -> PlainSamples:
        history.show(moment)
        history.see(camera(), new.on(arrays), 1, 0, whole(arrays, camera()))
        history.remember(new.on(arrays))
        return PlainSamples.of(history.recall(indices(arrays, new.pixels)))

    return run


def test_points_at_rest_are_where_their_pose_brings_them_back_from(arrays):
    rng = small.rng(4)
    moment = random_moment(rng, 0.5, 1.0)
    mover = np.array([STILL, 1, 2, UNSTEADY, 1], dtype=np.uint16)
    now = rng.normal(0, 1, (5, 3)).astype(np.float32)
    given = channels(arrays, now), floats(arrays, mover)
    rest = host(moment.at_rest(arrays, *given))
    for point, before, number in zip(now, rest, mover, strict=True):
        pose = moment.poses[number if number < 3 else 0]
        np.testing.assert_allclose(pose[:, :3] @ before + pose[:, 3], point, atol=1e-6)
    np.testing.assert_array_equal(host(ALWAYS.at_rest(arrays, *given)), now)


def test_samples_of_a_mover_go_with_it(arrays, after):
    """A painted wall that is shifted by ten pixels: every sample comes along, and none is left behind."""
    history, place = History(arrays), wall(camera())
    step = 10 * float(place[1, 0] - place[0, 0])
    painted = np.repeat(np.arange(SIZE * SIZE, dtype=np.float32)[:, None], 3, axis=1)
    after(history, shifted(0.0, 0.0), samples(place, painted, mover=1))
    dark = samples(place, np.zeros(3), mover=1)
    known = after(history, shifted(0.1, step), dark)
    column = known.pixels % SIZE
    inner = (column >= 11) & (column < SIZE - 11)
    assert (known.count[inner] == 1 + MOST_LATER).all()
    assert (known.count[column < 9] == 1).all()
    # Where it is now was painted ten less bright.
    expected = (painted[inner] - 10) * MOST_LATER / (1 + MOST_LATER)
    np.testing.assert_allclose(known.radiance[inner], expected, atol=1e-2)


@pytest.mark.parametrize(
    ("gloss", "mover", "kept"),
    [
        (DIFFUSE, STILL, MOST_LATER),
        (GLOSSY, STILL, 0),
        (SPECULAR, STILL, 0),
        (DIFFUSE, UNSTEADY, 0),
        (GLOSSY, 1, 0),
    ],
)
def test_only_what_looks_the_same_from_everywhere_does_later(arrays, after, gloss, mover, kept):
    history, place = History(arrays), wall(camera())
    new = samples(place, np.ones(3), gloss, mover=mover)
    assert (after(history, shifted(0.0, 0.0), new).count == 1).all()
    assert (after(history, shifted(0.0, 0.0), new).count == 2).all()
    assert (after(history, shifted(0.1, 0.0), new).count == 1 + kept).all()


def test_samples_of_another_moment_count_little(arrays, after):
    history, new = History(arrays), samples(wall(camera()), np.ones(3), count=100)
    after(history, shifted(0.0, 0.0), new)
    assert (after(history, shifted(0.1, 0.0), new).count == 100 + MOST_LATER).all()


def test_what_a_mover_hid_has_no_samples_of_it(arrays, after):
    """A board before a wall goes aside by more than it is wide: where it was, there is one sample."""
    history, view = History(arrays), camera()
    near, far = wall(view, -1.0), wall(view)
    column = np.arange(SIZE * SIZE) % SIZE

    def scene(left: int) -> PlainSamples:
        board = (column >= left) & (column < left + 10)
        place = np.where(board[:, None], near, far)
        bright = np.where(board, 9.0, 1.0)[:, None]
        shown = samples(place, np.repeat(bright, 3, axis=1))
        return replace(shown, mover=board.astype(np.uint16))

    step = 20 * float(near[1, 0] - near[0, 0])
    after(history, shifted(0.0, 0.0), scene(20))
    known = after(history, shifted(0.1, step), scene(40))
    assert (known.count[(column >= 21) & (column < 29)] == 1).all()
    assert (known.count[(column >= 41) & (column < 49)] == 1 + MOST_LATER).all()
    # A pixel at the edge of the board may keep a sample of the wall.
    beside = np.isin(column, [39, 40, 49, 50])
    np.testing.assert_array_equal(known.radiance[~beside], scene(40).radiance[~beside])
