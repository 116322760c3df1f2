"""Samples of earlier frames: where they go when the camera moves, and which of them no longer hold."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from compose.camera.camera import Camera, look_at
from compose.fovea.history import History
from compose.fovea.samples import DIFFUSE, GLOSSY, SPECULAR, Samples, merged
from tests import small

SIZE = 48


def camera(x: float = 0.0, turn: float = 0.0) -> Camera:
    """Looks along +z from z = -4, from x, turned by degrees."""
    target = [x + np.sin(np.radians(turn)), 0, -4 + np.cos(np.radians(turn))]
    pose = look_at(np.array([x, 0.0, -4]), np.array(target), np.array([0.0, -1, 0]))
    return Camera(np.linalg.inv(pose), SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2)


def wall(view: Camera, z: np.ndarray | float = 0.0) -> np.ndarray:
    """(D, 3) where the rays through all pixels' centres meet the plane at z."""
    rays = view.rays(view.pixel_centres())
    return view.position + rays * ((z - view.position[2]) / rays[:, 2])[:, None]


def samples(position: np.ndarray, radiance: np.ndarray, gloss: int = DIFFUSE, count: float = 1) -> Samples:
    size = len(position)
    flat = np.broadcast_to(np.asarray(radiance, dtype=np.float32), (size, 3)).astype(np.float32)
    return Samples(
        np.arange(size, dtype=np.uint32),
        np.full(size, count, dtype=np.float32),
        flat,
        flat**2,
        flat,
        flat,
        position.astype(np.float32),
        np.full(size, gloss, dtype=np.uint8),
    )


def added(history: History, view: Camera, new: Samples, seed: int) -> Samples:
    """All that is known of the new samples' pixels."""
    dark = np.zeros_like(new.radiance)
    seen = replace(new, count=np.zeros_like(new.count), radiance=dark, squares=dark)
    known = history.recall(view, new.pixels, seen, 4, seed)
    history.remember(new)
    return merged(known, new)


def test_what_was_looked_at_often_enough_need_not_be_again():
    history, view = History(), camera()
    new = samples(wall(view), np.array([0.5, 0.4, 0.3]))
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()
    added(history, view, new, 0)
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()
    half = new.pixels[: SIZE * SIZE // 2]
    part = Samples(*(getattr(new, field.name)[: len(half)] for field in fields(Samples)))
    history.recall(view, half, part, 4, 0)
    assert (history.unseen(view, new.pixels, 8) == new.pixels[len(half) :]).all()
    # What is known of the others is what was seen before.
    nothing = Samples(*(getattr(new, field.name)[:0] for field in fields(Samples)))
    known = history.recall(view, new.pixels, nothing, 4, 0)
    assert (known.position == new.position).all()
    assert np.allclose(known.albedo, new.albedo)
    assert (known.count == 1).all()
    assert (history.unseen(camera(0.1), new.pixels, 8) == new.pixels).all()
    # With more samples the auxiliary features must not fall behind.
    history.remember(replace(new, count=np.full_like(new.count, 10)))
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()


def test_a_still_camera_adds_up_exactly():
    history, view, rng = History(), camera(), small.rng()
    draws = rng.uniform(0, 2, (7, SIZE * SIZE, 3)).astype(np.float32)
    for draw in draws:
        kept = added(history, view, samples(wall(view), draw), 0)
    assert (kept.count == 7).all()
    np.testing.assert_allclose(kept.radiance, draws.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(kept.variance(), draws.var(axis=0, ddof=1) / 7, rtol=1e-3, atol=1e-5)


def test_one_sample_does_not_tell_its_variance():
    view = camera()
    assert np.isinf(samples(wall(view), np.ones(3)).variance()).all()


def test_a_moving_gaze_keeps_what_it_has_seen():
    history, view = History(), camera()
    everything = samples(wall(view), np.ones(3))
    part = lambda chosen: replace(  # noqa: E731
        everything, **{name: getattr(everything, name)[chosen] for name in everything.__dataclass_fields__}
    )
    left, right = slice(0, SIZE * SIZE // 2), slice(SIZE * SIZE // 4, SIZE * SIZE)
    added(history, view, part(left), 0)
    kept = added(history, view, part(right), 0)
    both = SIZE * SIZE // 4
    assert (kept.count[:both] == 2).all()
    assert (kept.count[both:] == 1).all()


@pytest.mark.parametrize("moved", [camera(x=0.31), camera(turn=3.7)], ids=["walk", "turn"])
def test_samples_go_where_their_place_is_seen(moved):
    """A wall painted with a slow wave: what arrives is what is there, to half a pixel."""
    paint = lambda place: 1 + np.sin(np.outer(place[:, 0], [2.0, 1.5, 1.0]))  # noqa: E731
    history, before = History(), camera()
    added(history, before, samples(wall(before), paint(wall(before)), count=8), 0)
    there = wall(moved)
    kept = added(history, moved, samples(there, paint(there)), 0)
    inside = np.abs(kept.count - 9) < 1
    assert inside.mean() > 0.5
    pixel = 4 / SIZE
    assert np.abs(kept.radiance - paint(there))[inside].max() < 2 * pixel * 0.75


def test_many_small_steps_do_not_blur():
    """A checkerboard after forty steps of a third of a pixel: still black and white inside the fields."""
    paint = lambda place: ((np.floor(place[:, :1]) + np.floor(place[:, 1:2])) % 2) * np.ones(3)  # noqa: E731
    history = History()
    for step in range(40):
        view = camera(x=step * 4 / SIZE / 3)
        there = wall(view)
        kept = added(history, view, samples(there, paint(there)), 0)
    inside = (np.abs(there[:, :2] - np.round(there[:, :2])) > 0.13).all(axis=1) & (kept.count > 8)
    assert inside.sum() > 300
    assert np.abs(kept.radiance - paint(there))[inside].max() < 0.05


def test_what_was_hidden_starts_anew():
    """A panel before a wall: when the camera steps aside, no sample of the panel is left on the wall."""
    history = History()

    def seen(view: Camera) -> tuple[np.ndarray, np.ndarray]:
        near = wall(view, -2.0)
        panel = (np.abs(near[:, 0]) < 0.5) & (np.abs(near[:, 1]) < 0.5)
        return np.where(panel[:, None], near, wall(view)), panel

    before, after = camera(), camera(x=0.5)
    place, panel_before = seen(before)
    added(history, before, samples(place, np.where(panel_before, 1.0, 0.2)[:, None], count=16), 0)
    place, panel = seen(after)
    kept = added(history, after, samples(place, np.where(panel, 1.0, 0.2)[:, None]), 0)
    away = np.abs(kept.radiance[:, 0] - np.where(panel, 1.0, 0.2)) > 0.1
    edge = panel.reshape(SIZE, SIZE)
    grown = edge.copy()
    for shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        grown |= np.roll(edge, shift[1], shift[0]) != edge
    # Only pixels on the panel's very outline may hold samples of both.
    assert not away[~(grown ^ edge).ravel() & ~_outline(edge)].any()
    fresh = (kept.count == 1).reshape(SIZE, SIZE) & ~edge
    assert fresh.sum() > 20


def _outline(mask: np.ndarray) -> np.ndarray:
    found = np.zeros_like(mask)
    for axis in (0, 1):
        for step in (1, -1):
            found |= np.roll(mask, step, axis) != mask
    return found.ravel()


@pytest.mark.parametrize(
    ("gloss", "walk", "kept_share"),
    [(SPECULAR, 0.2, 0), (GLOSSY, 0.8, 0), (GLOSSY, 0.1, 1), (DIFFUSE, 0.2, 1)],
)
def test_what_shines_is_forgotten_when_seen_from_elsewhere(gloss, walk, kept_share):
    history, before, after = History(), camera(), camera(x=walk)
    added(history, before, samples(wall(before), np.ones(3), gloss), 0)
    kept = added(history, after, samples(wall(after), np.ones(3), gloss), 0)
    middle = (kept.count > 1).reshape(SIZE, SIZE)[16:32, 16:32]
    assert (middle.mean() > 0.8) == bool(kept_share)
    assert kept_share or not middle.any()


def test_a_mirror_seen_from_the_same_place_is_kept():
    history, before, after = History(), camera(), camera(turn=2.0)
    added(history, before, samples(wall(before), np.ones(3), SPECULAR), 0)
    kept = added(history, after, samples(wall(after), np.ones(3), SPECULAR), 0)
    assert (kept.count > 1).mean() > 0.7
