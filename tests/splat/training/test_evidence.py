"""What moves is seen to move, and nothing else, whatever the light does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splat.training.moving_pixels import _votes, moving_pixels, objects_of
from tests.splat.training.scene import SIZE, observed

TIMES = np.linspace(0, 1, 10)
PLACES = np.tile([-0.1, 0.0, 0.08, 0.03, -0.05], 2)


def frames(**settings) -> tuple[list, np.ndarray]:
    """Ten frames; settings that are functions are of the time."""
    made = [
        observed(
            x, float(t), **{name: value(t) if callable(value) else value for name, value in settings.items()}
        )
        for t, x in zip(TIMES, PLACES, strict=True)
    ]
    return [one for one, _ in made], np.stack([moves for _, moves in made])


def scores(found: list, truth: np.ndarray) -> tuple[float, float]:
    """Precision and recall."""
    both = (np.stack(found) & truth).sum()
    return both / np.stack(found).sum(), both / truth.sum()


@pytest.mark.parametrize("albedo", [True, False])
def test_a_plain_card_is_seen_to_move(albedo):
    observations, truth = frames(card=lambda t: 1.4 * t - 0.7, albedo=albedo)
    precision, recall = scores(moving_pixels(observations), truth)
    assert precision > 0.97
    assert recall > 0.97


@pytest.mark.parametrize("albedo", [True, False])
def test_what_turns_in_its_own_plane_is_seen_to_move_by_its_texture(albedo):
    """Its distance stays what it is."""
    observations, truth = frames(turned=lambda t: 0.4 + 2.2 * t, albedo=albedo)
    precision, recall = scores(moving_pixels(observations), truth)
    # Patches of five pixels see it up to two pixels beside it.
    assert precision > 0.8
    assert recall > 0.75


@pytest.mark.parametrize("albedo", [True, False])
@given(
    dim=st.floats(0.2, 1.0),
    at=st.floats(-1, 1),
)
@settings(max_examples=8, deadline=None)
def test_light_that_changes_moves_nothing(albedo, dim, at):
    """Neither does a lamp that is dimmed, nor a soft shadow that wanders."""
    observations, _ = frames(albedo=albedo)
    column = np.linspace(-1, 1, SIZE)[None, :, None]
    lit = [
        replace(
            one,
            radiance=(
                one.radiance * (1 - (1 - dim) * one.time * np.exp(-((column - at - one.time) ** 2) / 0.5))
            ).astype(np.float32),
        )
        for one in observations
    ]
    assert not np.stack(moving_pixels(lit)).any()


def test_distances_that_do_not_know_of_what_moves_are_made_good_by_colours():
    """As a forest renders them that stands still."""
    observations, truth = frames(card=lambda t: 1.4 * t - 0.7)
    wall, _ = frames()
    smeared = [replace(one, distance=still.distance) for one, still in zip(observations, wall, strict=True)]
    precision, recall = scores(moving_pixels(smeared), truth)
    # Where the background shows what the card hid in a third of the near views, it counts as moving as well.
    assert precision > 0.45
    assert recall > 0.95


def test_votes_equal_those_counted_one_by_one():
    """Their twin: a pixel, a frame, nine pixels around where it would be."""
    observations, _ = frames(card=lambda t: 1.4 * t - 0.7)
    gone_in, there_in, *_ = _votes(observations, 4)
    points = observations[4].points
    for row, column in ((24, 20), (24, 24), (10, 30), (24, 30), (30, 8)):
        gone = there = 0
        for other in observations[:4] + observations[5:]:
            (position,), (depth,) = other.camera.project(points[row, column][None])
            if (position < 1).any() or (position >= SIZE - 1).any():
                continue
            x, y = position.astype(int)
            around = 1 / other.inverse_depth[y - 1 : y + 2, x - 1 : x + 2].astype(np.float64)
            if around.min() > depth * 1.005:
                gone += 1
            elif around.max() >= depth * 0.995:
                there += 1
        assert (gone_in[row, column], there_in[row, column]) == (gone, there)


def test_at_a_single_time_nothing_moves():
    observations, _ = frames(card=lambda t: 1.4 * t - 0.7)
    assert not np.stack(moving_pixels([replace(one, time=0.5) for one in observations])).any()
    assert moving_pixels([]) == []


def test_of_one_frame_and_of_empty_ones_nothing_is_known():
    observations, _ = frames(card=0.0)
    assert not moving_pixels(observations[:1])[0].any()
    empty = [replace(one, distance=np.full((SIZE, SIZE), np.inf, np.float32)) for one in observations]
    found = moving_pixels(empty)
    assert not np.stack(found).any()
    assert (np.stack(objects_of(empty, found)) == -1).all()


def test_two_cards_are_two_objects_whatever_frame_shows_them():
    left, left_moves = frames(card=lambda t: -0.7 + 0.1 * t)
    right, right_moves = frames(card=lambda t: 0.7 - 0.2 * t)
    both = [replace(a, distance=np.minimum(a.distance, b.distance)) for a, b in zip(left, right, strict=True)]
    found = np.stack(objects_of(both, list(left_moves | right_moves)))
    assert set(np.unique(found)) == {-1, 0, 1}
    assert len(np.unique(found[left_moves])) == len(np.unique(found[right_moves])) == 1
    assert (found[~(left_moves | right_moves)] == -1).all()
