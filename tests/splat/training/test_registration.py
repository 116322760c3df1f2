"""A field is fitted to where frames see what moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.choices import FieldKind
from splat.model.gaussians import Gaussians
from splat.model.motion import LearnedMotion
from splat.training.field_training import register
from splat.training.training_view import TrainingView
from tests.splat.training.test_moving import CENTRE, TIMES, TURN, VIEWS, WAY

STEPS = 400


def registered(views: list[TrainingView], steps: int = STEPS) -> LearnedMotion:
    motion = LearnedMotion.begun(FieldKind.D_GS, -torch.ones(3), torch.ones(3), 0)
    register(motion, views, steps, 0)
    return motion


def row(points: np.ndarray) -> Gaussians:
    """Gaussians at points (N, 3)."""
    n = len(points)
    rotations = torch.tensor([[1.0], [0], [0], [0]]).repeat(1, n)
    means = torch.from_numpy(points.T.astype(np.float32).copy())
    return Gaussians(means, torch.full((3, n), -4.0), rotations, torch.zeros(n), torch.zeros(1, 3, n))


@pytest.fixture(scope="module")
def motion() -> LearnedMotion:
    return registered(VIEWS)


def on_card(time: float) -> np.ndarray:
    """The middle of the card, and two points 0.3 to the sides."""
    along = np.array([np.cos(time * TURN), np.sin(time * TURN), 0])
    return CENTRE + [time * WAY, 0, 0] + np.array([[0.0], [0.3], [-0.3]]) * along


@pytest.mark.parametrize(("start", "end"), [(7, 2), (3, 9), (5, 6)])
def test_what_is_seen_at_one_time_is_where_the_card_is_at_another(motion, start, end):
    """The card goes by more than it is long, and turns by a quarter."""
    none, start, end = torch.zeros(3, dtype=torch.int64), TIMES[start], TIMES[end]
    with torch.no_grad():
        rest = motion.at_rest(row(on_card(start)), none, start)
        shown = motion.shown(rest, none, end).means.T.numpy()
    off = np.linalg.norm(shown - on_card(end), axis=1)
    assert off[0] < 0.15
    assert off.max() < 0.35


def test_the_way_back_to_rest_and_forth_again_leads_home(motion):
    none = torch.zeros(3, dtype=torch.int64)
    points = row(on_card(TIMES[5]))
    with torch.no_grad():
        shown = motion.shown(motion.at_rest(points, none, TIMES[5]), none, TIMES[5])
    assert float((shown.means - points.means).norm(dim=0).max()) < 0.1


def test_what_stands_still_comes_to_rest_where_it_is(motion):
    points = row(on_card(0.5))
    rest = motion.at_rest(points, torch.full((3,), -1), 0.5)
    torch.testing.assert_close(rest.means, points.means, rtol=0, atol=0)


@pytest.mark.parametrize(
    "changes",
    [
        {"guessed": True},
        {"instance": None},
        {"instance": np.zeros(VIEWS[0].distance.shape, dtype=np.int32)},
        {"distance": np.full(VIEWS[0].distance.shape, np.inf, dtype=np.float32)},
    ],
)
def test_where_nobody_knows_where_anything_is_the_field_stays(changes):
    """Guessed distances, no labels, labels that tell nothing apart, nothing seen."""
    motion = registered([replace(view, **changes) for view in VIEWS], 3)
    before = LearnedMotion.begun(FieldKind.D_GS, -torch.ones(3), torch.ones(3), 0)
    for name, tensor in before.tensors().items():
        torch.testing.assert_close(motion.tensors()[name], tensor, rtol=0, atol=0)


def test_the_same_seed_gives_the_same_field():
    first, second = registered(VIEWS, 4), registered(VIEWS, 4)
    for name, tensor in first.tensors().items():
        torch.testing.assert_close(second.tensors()[name], tensor, rtol=0, atol=0)


def test_an_instance_that_is_hardly_seen_is_left_out():
    """One of few pixels, and one that one frame in three shows."""
    views = []
    for number, view in enumerate(VIEWS):
        labels = np.where(view.instance == 0, 2 if number % 3 == 0 else -1, -1)
        labels[:2, :2] = 1
        views.append(replace(view, instance=labels.astype(np.int32)))
    motion = registered(views, 3)
    assert all(float(head.weight.detach().abs().max()) == 0 for head in motion.field.heads.shifts)
