"""What is shown where: mixtures that proved to be better on unseen views, else the better parent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.fusion import fitting as module
from compose.fusion.fitting import TRIAL_ITERATIONS, Example, prove, trials
from compose.fusion.network import Fusion
from tests.compose.fusion.examples import blurred, example, radiance_of

SIZE = 128


def with_parents(seed: int, denoised: float, splat: float, spp: int = 2) -> Example:
    """A view whose parents have independent errors of given sizes."""
    given = example(seed, spp, SIZE)
    rng, right = np.random.default_rng(seed), radiance_of(given)
    wrong = lambda size: np.abs(right + size * rng.normal(size=right.shape)).astype(np.float32)  # noqa: E731
    parents = replace(given.parents, denoised=wrong(denoised), splat=wrong(splat), enlargement=1.0)
    return replace(given, parents=parents)


@pytest.fixture
def useless(monkeypatch) -> list[int]:
    """Networks are not fitted: they show noise. Returns the number of examples that each would learn from."""
    learnt = []

    def fit(examples, seed, progress, iterations) -> Fusion:
        learnt.append(len(examples))
        progress(iterations, iterations)
        return Fusion()

    def noise(fusion, images, parents) -> tuple[torch.Tensor, None]:
        return torch.rand(images["splat"].shape, generator=torch.Generator().manual_seed(0)), None

    monkeypatch.setattr(module, "fit", fit)
    monkeypatch.setattr(module, "estimated", noise)
    return learnt


def ignore(done: int, total: int) -> None:
    pass


def test_a_useless_network_gets_no_share(useless):
    found = prove([with_parents(seed, 0.02, 0.2) for seed in range(4)], 0, ignore)
    assert (found.shares[..., 0] == 0).all()
    # Splats with ten times the error hardly help, if at all.
    assert (found.shares[..., 1] > 0.9).all()
    np.testing.assert_allclose(found.shares.sum(-1), 1, atol=1e-6)


def test_independent_parents_of_equal_quality_are_averaged(useless):
    """Their mean has half the squared error: 3 dB."""
    found = prove([with_parents(seed, 0.05, 0.05) for seed in range(4)], 0, ignore)
    np.testing.assert_allclose(found.shares[..., 1:], 0.5, atol=0.1)
    assert found.gains == pytest.approx(np.full((2, 5, 4), 3.0), abs=0.5)


@pytest.mark.parametrize(("denoised", "splat", "better"), [(0.02, 0.4, 1), (0.4, 0.02, 2)])
def test_of_parents_that_cannot_be_improved_the_better_one_is_shown_alone(useless, denoised, splat, better):
    found = prove([with_parents(seed, denoised, splat) for seed in range(4)], 0, ignore)
    np.testing.assert_array_equal(found.shares, np.broadcast_to(np.eye(3)[better], (2, 5, 4, 3)))
    assert (found.gains == 0).all()


def test_a_mixture_that_helps_one_view_only_is_not_shown(useless):
    """Three views say that the denoised samples are best, one that the splats are."""
    views = [with_parents(seed, 0.03, 0.3) for seed in range(3)] + [with_parents(3, 0.3, 0.03)]
    found = prove(views, 0, ignore)
    assert (found.shares[..., 1] > found.shares[..., 2]).all()


def test_a_fitted_network_that_is_better_gets_its_share(monkeypatch):
    monkeypatch.setattr(module, "TRIAL_ITERATIONS", 40)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    found = prove([example(seed, 4, SIZE) for seed in range(4)], 0, ignore)
    torch.set_num_threads(threads)
    assert found.shares[0, 2, 1, 0] > 0.5
    assert found.gains[0, 2, 1] > 3


def test_every_view_is_tried_by_a_network_that_has_not_seen_it(useless):
    prove([with_parents(seed, 0.1, 0.1) for seed in (0, 0, 1, 2, 3, 3)], 0, ignore)
    # Views 0 and 2 have three of the six examples.
    assert useless == [3, 3]


def test_one_view_alone_proves_nothing(useless):
    one = [with_parents(0, 0.05, 0.05), with_parents(0, 0.05, 0.05, 4)]
    assert trials(1) == 0
    found = prove(one, 0, ignore)
    assert not useless
    assert (found.gains == 0).all()
    assert set(np.unique(found.shares)) == {0, 1}
    assert (found.shares[..., 0] == 0).all()


def test_conditions_that_were_not_tried_get_the_nearest_verdict(useless):
    few = [with_parents(seed, 0.3, 0.02, 1) for seed in range(3)]
    many = [with_parents(seed, 0.02, 0.3, 16) for seed in range(3)]
    found = prove(few + many, 0, ignore)
    assert (found.shares[:, :2, :, 2] == 1).all()
    assert (found.shares[:, 3:, :, 1] == 1).all()


def with_noisy_reference(given: Example, seed: int) -> Example:
    """The example with a reference whose halves have ten times the parents' error."""
    rng, right = np.random.default_rng(seed), radiance_of(given)
    halves = tuple(
        np.float32(right + 0.3 * rng.normal(size=right.shape)).astype(np.float32) for _ in range(2)
    )
    reference = replace(given.reference, denoised=blurred(right, 0.5), halves=halves)
    return replace(given, reference=reference)


def test_noise_of_the_references_does_not_favour_the_noisier_parent(useless):
    """The same noise in reference and parent would; independent noise leaves the better one."""
    views = [with_noisy_reference(with_parents(seed, 0.02, 0.1), 100 + seed) for seed in range(4)]
    found = prove(views, 0, ignore)
    assert (found.shares[..., 1] > 0.8).all()


def test_noise_of_the_references_does_not_raise_the_stated_gain(useless):
    """The mean of two independent parents has half their squared error, whoever measures it."""
    views = [with_noisy_reference(with_parents(seed, 0.05, 0.05), 100 + seed) for seed in range(12)]
    found = prove(views, 0, ignore)
    assert found.gains == pytest.approx(np.full((2, 5, 4), 3.0), abs=1.0)


def test_progress_runs_over_both_trials(useless):
    steps = []
    prove([with_parents(seed, 0.1, 0.1) for seed in range(2)], 0, lambda *step: steps.append(step))
    assert steps == [(TRIAL_ITERATIONS, 2 * TRIAL_ITERATIONS), (2 * TRIAL_ITERATIONS, 2 * TRIAL_ITERATIONS)]
