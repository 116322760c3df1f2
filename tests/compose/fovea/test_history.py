"""Samples of earlier frames: how they add up, and what is left of them when the camera moves."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR
from compose.camera.camera import Camera
from compose.fovea.history import History
from compose.fovea.samples import merged
from tests import small
from tests.compose.arrays_of import PlainSamples, indices, numbers
from tests.compose.fovea.views import SIZE, camera, samples, wall, whole

ALL = SIZE * SIZE


class PlainHistory:
    """A history that is asked with arrays of NumPy, and answers with them."""

    def __init__(self, arrays: Arrays, history: History | None = None):
        self.arrays, self.history = arrays, history or History(arrays)

    def see(self, view: Camera, new: PlainSamples, positions: int, seed: int) -> None:
        self.history.see(view, new.on(self.arrays), positions, seed, whole(self.arrays, view))

    def remember(self, new: PlainSamples) -> None:
        self.history.remember(new.on(self.arrays))

    def recall(self, pixels: np.ndarray) -> PlainSamples:
        return PlainSamples.of(self.history.recall(indices(self.arrays, pixels)))

    def unseen(self, view: Camera, pixels: np.ndarray, positions: int) -> np.ndarray:
        return np.array(self.history.unseen(view, indices(self.arrays, pixels), positions))

    def sampled(self, view: Camera, pixels: np.ndarray, seed: int) -> tuple[np.ndarray, int]:
        counts, pattern = self.history.sampled(view, indices(self.arrays, pixels), seed)
        return np.array(counts), pattern


def added(history: PlainHistory, view: Camera, new: PlainSamples, seed: int = 0) -> PlainSamples:
    """All that is known of the new samples' pixels after a frame."""
    known = seen(history, view, new.pixels, unlit(new), 4, seed)
    history.remember(new)
    return PlainSamples.of(merged(known.on(history.arrays), new.on(history.arrays)))


def seen(
    history: PlainHistory,
    view: Camera,
    pixels: np.ndarray,
    new: PlainSamples,
    positions: int,
    seed: int = 0,
) -> PlainSamples:
    """All that is known of some pixels after new auxiliary features were added."""
    history.see(view, new, positions, seed)
    return history.recall(pixels)


def unlit(new: PlainSamples) -> PlainSamples:
    """Auxiliary features alone."""
    dark = np.zeros_like(new.radiance)
    return replace(new, count=np.zeros_like(new.count), radiance=dark, squares=dark)


def again(number: int) -> Camera:
    """Cameras that differ, but see the same."""
    return replace(camera(), fx=SIZE + number * 1e-9)


def test_auxiliary_features_are_traced_until_they_are_good_enough(arrays):
    history, view = PlainHistory(arrays), camera()
    new = samples(wall(view), np.array([0.5, 0.4, 0.3]))
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()
    added(history, view, new)  # 4 sample positions
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()
    assert not len(history.unseen(view, new.pixels, 4))
    half = new.part(slice(0, ALL // 2))
    seen(history, view, half.pixels, half, 4)
    assert (history.unseen(view, new.pixels, 8) == new.pixels[ALL // 2 :]).all()
    assert (history.unseen(camera(0.1), new.pixels, 8) == new.pixels).all()
    # They must not fall behind the samples.
    history.remember(replace(new, count=np.full_like(new.count, 10)))
    assert (history.unseen(view, new.pixels, 8) == new.pixels).all()


def test_64_sample_positions_are_enough_for_any_number_of_samples(arrays):
    history, view = PlainHistory(arrays), camera()
    new = samples(wall(view), np.ones(3), count=1000)
    seen(history, view, new.pixels, unlit(new), 63)
    history.remember(new)
    assert len(history.unseen(view, new.pixels, 8)) == ALL
    seen(history, view, new.pixels, unlit(new), 1)
    assert not len(history.unseen(view, new.pixels, 8))


def test_what_was_seen_before_is_known_without_looking_again(arrays):
    history, view = PlainHistory(arrays), camera()
    new = samples(wall(view), np.array([0.5, 0.4, 0.3]), GLOSSY)
    added(history, view, new)
    known = seen(history, view, new.pixels, new.part(slice(0, 0)), 4)
    assert (known.position == new.position).all()
    assert (known.gloss == GLOSSY).all()
    assert (known.count == 1).all()
    np.testing.assert_allclose(known.albedo, new.albedo)
    np.testing.assert_allclose(known.normal, new.normal)


def test_it_says_how_many_samples_were_reprojected(arrays):
    history, view = PlainHistory(arrays), camera()
    new = samples(wall(view), np.ones(3), count=3)
    assert (added(history, view, new).earlier == 0).all()
    assert (added(history, view, new).earlier == 0).all()
    known = added(history, again(1), new)
    np.testing.assert_allclose(known.count, known.earlier + 3, rtol=1e-5)
    assert np.median(known.earlier) > 3


def test_auxiliary_features_are_means_over_sample_positions(arrays):
    """4 positions of 0.2 and 12 of 0.6: 0.5; what they hit is what the first ones hit."""
    history, view = PlainHistory(arrays), camera()
    first = samples(wall(view), np.full(3, 0.2), GLOSSY)
    second = samples(wall(view, 1.0), np.full(3, 0.6), SPECULAR)
    seen(history, view, first.pixels, first, 4)
    known = seen(history, view, first.pixels, second, 12)
    np.testing.assert_allclose(known.albedo, 0.5, rtol=1e-6)
    np.testing.assert_allclose(known.normal, 0.5, rtol=1e-6)
    assert (known.position == first.position).all()
    assert (known.gloss == GLOSSY).all()
    assert (known.count == 0).all()


def test_further_samples_continue_the_pattern_of_the_first_ones(arrays):
    history, view = PlainHistory(arrays), camera()
    new = samples(wall(view), np.ones(3), count=3)
    counts, seed = history.sampled(view, new.pixels, 5)
    assert seed == 5
    assert (counts == 0).all()
    added(history, view, new.part(slice(0, 100)), seed=5)
    counts, seed = history.sampled(view, new.pixels, 6)
    assert seed == 5
    assert counts.dtype == np.uint32
    assert (counts[:100] == 3).all()
    assert (counts[100:] == 0).all()
    counts, seed = history.sampled(camera(0.1), new.pixels, 7)
    assert seed == 7
    assert (counts == 0).all()


def test_a_still_camera_adds_up_exactly(arrays):
    history, view, rng = PlainHistory(arrays), camera(), small.rng()
    draws = rng.uniform(0, 2, (7, SIZE * SIZE, 3)).astype(np.float32)
    for draw in draws:
        kept = added(history, view, samples(wall(view), draw))
    assert (kept.count == 7).all()
    np.testing.assert_allclose(kept.radiance, draws.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(
        numbers(kept.on(arrays), "variance"), draws.var(axis=0, ddof=1) / 7, rtol=1e-3, atol=1e-5
    )


def test_a_moving_gaze_keeps_what_it_has_seen(arrays):
    history, view = PlainHistory(arrays), camera()
    everything = samples(wall(view), np.ones(3))
    added(history, view, everything.part(slice(0, ALL // 2)))
    kept = added(history, view, everything.part(slice(ALL // 4, ALL)))
    both = ALL // 4
    assert (kept.count[:both] == 2).all()
    assert (kept.count[both:] == 1).all()


def test_earlier_views_count_as_32_samples_per_pixel_at_most(arrays):
    """A thousand black samples from one camera and two white ones from the next: 2 of 34."""
    history = PlainHistory(arrays)
    place = wall(camera())
    added(history, again(0), samples(place, np.zeros(3), count=1000))
    kept = added(history, again(1), samples(place, np.ones(3), count=2))
    inside = kept.count.reshape(SIZE, SIZE)[4:-4, 4:-4]
    np.testing.assert_allclose(inside, 34)
    np.testing.assert_allclose(kept.radiance.reshape(SIZE, SIZE, 3)[4:-4, 4:-4], 2 / 34, rtol=1e-5)


def test_sixteen_earlier_views_are_remembered(arrays):
    history = PlainHistory(arrays)
    place = wall(camera())
    counts = [added(history, again(n), samples(place, np.ones(3))).count[ALL // 2 + 24] for n in range(20)]
    assert counts == [min(n, 16) + 1 for n in range(20)]


def test_another_frame_size_starts_anew(arrays):
    history, view = PlainHistory(arrays), camera()
    place = wall(view)
    added(history, again(0), samples(place, np.ones(3)))
    added(history, again(1), samples(place, np.ones(3)))
    larger = view.resized(SIZE * 2, SIZE)
    kept = added(history, larger, samples(wall(larger), np.ones(3)).part(slice(0, ALL)))
    assert (kept.count == 1).all()
    assert (added(history, again(2), samples(place, np.ones(3))).count == 1).all()


def test_a_saved_history_continues_the_view(arrays):
    history, view = PlainHistory(arrays), camera()
    assert history.history.state() == {}
    first = samples(wall(view), np.array([0.1, 0.2, 0.3]), GLOSSY, count=3).part(slice(0, 500))
    added(history, view, first, seed=9)
    state = {name: values.copy() for name, values in history.history.state().items()}
    hits, moment = {"position", "gloss", "mover"}, {"time", "poses"}
    assert set(state) == {"count", "light", "places", "guides", "pattern"} | hits | moment
    restored = PlainHistory(arrays, History.restored(arrays, view, state))
    second = samples(wall(view), np.array([0.5, 0.5, 0.9]))
    for wanted in (4, 8):
        found = restored.unseen(view, second.pixels, wanted)
        assert (found == history.unseen(view, second.pixels, wanted)).all()
    assert restored.sampled(view, second.pixels, 0)[1] == 9
    assert (restored.sampled(view, second.pixels, 0)[0] == history.sampled(view, second.pixels, 0)[0]).all()
    one, other = added(history, view, second), added(restored, view, second)
    for field in fields(PlainSamples):
        assert (getattr(one, field.name) == getattr(other, field.name)).all()


def test_a_history_that_was_saved_before_things_could_move_is_restored(arrays):
    history, view = PlainHistory(arrays), camera()
    added(history, view, samples(wall(view), np.array([0.1, 0.2, 0.3]), count=3))
    state = {k: v for k, v in history.history.state().items() if k not in ("mover", "time", "poses")}
    new = samples(wall(view), np.ones(3))
    restored = PlainHistory(arrays, History.restored(arrays, view, state))
    one, other = added(history, view, new), added(restored, view, new)
    for field in fields(PlainSamples):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize("moved", [camera(x=0.31), camera(turn=3.7)], ids=["walk", "turn"])
def test_samples_move_to_where_their_hit_points_are_visible(arrays, moved):
    """A wall painted with a slow wave: what arrives is what is there, to within half a pixel."""
    paint = lambda place: 1 + np.sin(np.outer(place[:, 0], [2.0, 1.5, 1.0]))  # noqa: E731
    history, before = PlainHistory(arrays), camera()
    added(history, before, samples(wall(before), paint(wall(before)), count=8))
    there = wall(moved)
    kept = added(history, moved, samples(there, paint(there)))
    inside = np.abs(kept.count - 9) < 1
    assert inside.mean() > 0.5
    pixel = 4 / SIZE
    assert np.abs(kept.radiance - paint(there))[inside].max() < 2 * pixel * 0.75


def test_auxiliary_features_move_with_the_samples(arrays):
    """Albedo is the mean of a view's and of that which the view before it brings, by sample positions."""
    history, before, after = PlainHistory(arrays), camera(), camera(x=0.31)
    added(history, before, samples(wall(before), np.full(3, 0.2)))  # 4 sample positions
    there = samples(wall(after), np.full(3, 0.8))
    known = seen(history, after, there.pixels, unlit(there), 1)
    once = known.count == 1
    assert once.mean() > 0.5
    np.testing.assert_allclose(known.albedo[once], (4 * 0.2 + 0.8) / 5, rtol=1e-5)
    new = known.count == 0
    np.testing.assert_allclose(known.albedo[new], 0.8, rtol=1e-6)
    # Where they are enough, no more are traced; but what this view does not show yet must be seen.
    assert set(history.unseen(after, there.pixels, 4)) == set(there.pixels[new])
    history = PlainHistory(arrays)
    added(history, before, samples(wall(before), np.full(3, 0.2)))
    history.see(after, unlit(there.part(slice(0, 1000))), 4, 0)
    assert set(there.pixels[1000:]) <= set(history.unseen(after, there.pixels, 4))


def test_many_small_steps_do_not_blur(arrays):
    """A checkerboard after forty steps of a third of a pixel: still black and white inside its squares."""
    paint = lambda place: ((np.floor(place[:, :1]) + np.floor(place[:, 1:2])) % 2) * np.ones(3)  # noqa: E731
    history = PlainHistory(arrays)
    for step in range(40):
        view = camera(x=step * 4 / SIZE / 3)
        there = wall(view)
        kept = added(history, view, samples(there, paint(there)))
    inside = (np.abs(there[:, :2] - np.round(there[:, :2])) > 0.13).all(axis=1) & (kept.count > 8)
    assert inside.sum() > 300
    assert np.abs(kept.radiance - paint(there))[inside].max() < 0.05


def test_a_surface_that_was_hidden_starts_anew(arrays):
    """A panel in front of a wall: when the camera steps aside, no sample of the panel is left on the wall."""
    history = PlainHistory(arrays)

    def seen(view: Camera) -> tuple[np.ndarray, np.ndarray]:
        near = wall(view, -2.0)
        panel = (np.abs(near[:, 0]) < 0.5) & (np.abs(near[:, 1]) < 0.5)
        return np.where(panel[:, None], near, wall(view)), panel

    before, after = camera(), camera(x=0.5)
    place, panel_before = seen(before)
    added(history, before, samples(place, np.where(panel_before, 1.0, 0.2)[:, None], count=16))
    place, panel = seen(after)
    kept = added(history, after, samples(place, np.where(panel, 1.0, 0.2)[:, None]))
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
def test_reflections_are_forgotten_when_seen_from_elsewhere(arrays, gloss, walk, kept_share):
    history, before, after = PlainHistory(arrays), camera(), camera(x=walk)
    added(history, before, samples(wall(before), np.ones(3), gloss))
    kept = added(history, after, samples(wall(after), np.ones(3), gloss))
    middle = (kept.count > 1).reshape(SIZE, SIZE)[16:32, 16:32]
    assert (middle.mean() > 0.8) == bool(kept_share)
    assert kept_share or not middle.any()


def test_a_mirror_seen_from_the_same_place_is_kept(arrays):
    history, before, after = PlainHistory(arrays), camera(), camera(turn=2.0)
    added(history, before, samples(wall(before), np.ones(3), SPECULAR))
    kept = added(history, after, samples(wall(after), np.ones(3), SPECULAR))
    assert (kept.count > 1).mean() > 0.7
