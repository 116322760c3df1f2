"""Density control: where and when Gaussians are added and removed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.training.density import DensityControl
from splat.training.initialization import seed_at
from tests.splat.training.frames import SIZE, WALLS, wall


def seeds(count: int):
    return seed_at(WALLS[0], np.arange(count), 0.6, degree=1).gaussians


def control(initial: int, final: int, iterations: int = 1000) -> DensityControl:
    density = DensityControl(iterations, initial, final)
    density.observe(0, torch.ones(SIZE, SIZE))
    return density


def test_changes_come_every_hundred_steps_for_a_part_of_the_training():
    """Of 1000 steps between 5 and 60 percent."""
    density = DensityControl(1000, 10, 20)
    assert [i for i in range(1000) if density.is_due(i)] == [99, 199, 299, 399, 499, 599]
    assert [i for i in range(4000) if DensityControl(4000, 1, 2).is_due(i)][:2] == [299, 399]


def test_the_number_rises_in_equal_steps_to_the_final_one():
    """From 100 to 600: 55 percent of 1000 steps are 5 rounds, of 100 each."""
    density, rng = control(100, 600), np.random.default_rng(0)
    counts = []
    count = 100
    for _ in range(7):
        kept, added = density.change(seeds(count), WALLS, rng)
        count = len(kept) + len(added)
        counts.append(count)
    assert counts == [200, 300, 400, 500, 600, 600, 600]


def test_transparent_and_broken_gaussians_are_removed_and_replaced():
    g = seeds(50)
    logit = lambda p: float(np.log(p / (1 - p)))  # noqa: E731
    g.opacity_logits[3], g.opacity_logits[4] = logit(0.0199), logit(0.0201)
    g.means[1, 7] = float("nan")
    g.log_scales[0, 9] = float("inf")
    kept, added = control(50, 50).change(g, WALLS, np.random.default_rng(0))
    assert sorted(set(range(50)) - set(kept.tolist())) == [3, 7, 9]
    assert len(added) == 3
    assert added.gaussians.degree == 1


def test_the_number_never_passes_the_final_one():
    kept, added = control(10, 40).change(seeds(60), WALLS, np.random.default_rng(0))
    assert (len(kept), len(added)) == (60, 0)


def test_new_ones_go_where_the_error_is():
    """All of them to the only two pixels with an error and a surface, each once."""
    view = wall(0.0)
    view.distance[5, 5] = np.inf
    density = DensityControl(1000, 10, 500)
    error = torch.zeros(SIZE, SIZE)
    error[2, 3], error[4, 1], error[5, 5] = 1.0, 3.0, 100.0
    density.observe(0, error)
    _, added = density.change(seeds(10), [view], np.random.default_rng(0))
    position, _ = view.camera.project(added.gaussians.means.T.double().numpy())
    np.testing.assert_allclose(sorted(position.tolist()), [[1.5, 4.5], [3.5, 2.5]], atol=1e-4)


def test_pixels_without_a_surface_are_not_drawn():
    """They have a thousand times the error of the others, which get all 90 new ones nevertheless."""
    view = wall(0.0)
    view.distance[: SIZE // 2] = np.inf
    density = DensityControl(100, 10, 460)
    error = torch.ones(SIZE, SIZE)
    error[: SIZE // 2] = 1000.0
    density.observe(0, error)
    _, added = density.change(seeds(10), [view], np.random.default_rng(0))
    assert len(added) == 90


def test_pixels_are_drawn_in_proportion_to_their_error():
    """An error of 3 in the upper half and 1 in the lower: three quarters above. 400 draws, sd 2.2 percent."""
    density = DensityControl(1000, 10, 410)
    error = torch.ones(SIZE, SIZE)
    error[: SIZE // 2] = 3.0
    density.observe(0, error)
    above = total = 0
    for seed in range(5):
        _, added = density.change(seeds(10), [WALLS[1]], np.random.default_rng(seed))
        position, _ = WALLS[1].camera.project(added.gaussians.means.T.double().numpy())
        above, total = above + (position[:, 1] < SIZE / 2).sum(), total + len(added)
    assert total == 400
    # Five standard deviations.
    assert above / total == pytest.approx(0.75, abs=0.11)


def test_views_share_in_proportion_to_their_mean_error():
    """1 to 4, over 5 x 80 = 400 draws: 0.2 with a standard deviation of 2 percent."""
    density = DensityControl(1000, 10, 410)
    density.observe(0, torch.full((SIZE, SIZE), 0.1))
    density.observe(2, torch.full((SIZE, SIZE), 0.4))
    from_first = total = 0
    for seed in range(5):
        _, added = density.change(seeds(10), WALLS, np.random.default_rng(seed))
        x, _ = WALLS[0].camera.project(added.gaussians.means.T.double().numpy())
        # Seeds of the first view lie at its pixels' centres.
        centred = np.abs(x - np.floor(x) - 0.5).max(axis=1) < 1e-3
        from_first, total = from_first + centred.sum(), total + len(added)
    assert from_first / total == pytest.approx(0.2, abs=0.1)


def test_without_any_error_nothing_is_drawn():
    density = DensityControl(1000, 10, 100)
    density.observe(0, torch.zeros(SIZE, SIZE))
    density.observe(1, torch.zeros(SIZE, SIZE))
    kept, added = density.change(seeds(10), WALLS, np.random.default_rng(0))
    assert (len(kept), len(added)) == (10, 0)


def test_the_latest_error_counts_and_is_restored():
    density = DensityControl(1000, 10, 100)
    density.observe(1, torch.ones(2, 2))
    density.observe(1, torch.zeros(2, 2))
    density.observe(12, torch.full((2, 2), 5.0))
    state = density.state()
    again = DensityControl(1000, 10, 100)
    again.restore({**state, "other": torch.ones(1)})
    assert again.state().keys() == state.keys()
    for name, tensor in again.state().items():
        assert torch.equal(tensor, state[name])
    assert state["error.1"].sum() == 0


def test_new_ones_go_where_the_set_shows_a_surface_if_distances_are_guesses():
    """Of 40 views, 16 get new Gaussians, at the distances that they are measured to have."""
    views = [replace(wall(x), guessed=True) for x in np.linspace(-0.5, 0.5, 40)]
    density = DensityControl(1000, 10, 10_000)
    for number in range(len(views)):
        density.observe(number, torch.ones(SIZE, SIZE))
    seen = []

    def measured(view):
        seen.append(view.camera)
        return replace(view, distance=view.distance * np.float32(0.5))

    _, added = density.change(seeds(10), views, np.random.default_rng(0), measured)
    assert len({camera.key for camera in seen}) == len(seen) == 16
    # Half-way from the cameras at z = -3 to the wall at z = 0.
    assert torch.allclose(added.gaussians.means[2], torch.tensor(-1.5), atol=1e-5)
