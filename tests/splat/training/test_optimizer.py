"""Adam that moves some Gaussians at a time, and whose moments survive changes of the set."""

from __future__ import annotations

import pytest
import torch

from splat.model.gaussians import Gaussians, concatenated
from splat.training.gaussian_optimizer import GaussianOptimizer
from tests.splat.samples import equal, gaussians


def loss_of(g: Gaussians) -> torch.Tensor:
    """Pulls every parameter towards 0."""
    further = [] if g.directional is None else [g.directional.sh]
    return sum((tensor**2).sum() for tensor in [*(tensor for _, tensor in g.tensors()), *further])


def stepped(optimizer: GaussianOptimizer, steps: int = 1, progress: float = 0.0) -> GaussianOptimizer:
    for _ in range(steps):
        everything = torch.arange(len(optimizer.gaussians))
        optimizer.step(loss_of(optimizer.chosen(everything)), progress)
    return optimizer


def test_it_starts_from_copies():
    g = gaussians(n=5, degree=2)
    before = g.select(torch.arange(5))
    optimizer = GaussianOptimizer(g, 1.0)
    assert equal(optimizer.gaussians, g)
    stepped(optimizer)
    assert equal(g, before)


@pytest.mark.parametrize(
    ("progress", "rates"),
    [
        (0.0, {"means": 0.15, "log_scales": 0.1, "rotations": 0.016, "opacity_logits": 0.05}),
        # Half-way between the ends on a logarithmic scale: the root of their product.
        (0.5, {"means": 0.03, "log_scales": 0.0447214, "rotations": 0.008, "opacity_logits": 0.0223607}),
        (1.0, {"means": 0.006, "log_scales": 0.02, "rotations": 0.004, "opacity_logits": 0.01}),
    ],
)
def test_the_first_step_is_as_long_as_the_rate(progress, rates):
    """Adam's first step is the rate itself, against the gradient; positions are in units of a pixel."""
    g = gaussians(n=5, degree=1)
    moved = stepped(GaussianOptimizer(g, 0.2), 1, progress).gaussians.all_turning()
    for name, rate in rates.items():
        unit = 0.2 if name == "means" else 1.0
        expected = getattr(g, name) - unit * rate * getattr(g, name).sign()
        torch.testing.assert_close(getattr(moved, name), expected, rtol=1e-4, atol=1e-6)
    constant, directional = {0.0: (0.016, 0.0016), 0.5: (0.00619677, 0.0008), 1.0: (0.0024, 0.0004)}[progress]
    torch.testing.assert_close(moved.sh[0], g.sh[0] - constant * g.sh[0].sign(), rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(moved.sh[1:], g.sh[1:] - directional * g.sh[1:].sign(), rtol=1e-4, atol=1e-6)


def test_kept_gaussians_keep_their_moments():
    """After a change the kept ones move on as if nothing had happened, in whatever order they are."""
    whole = stepped(GaussianOptimizer(gaussians(n=6, degree=1), 1.0), 5)
    part = stepped(GaussianOptimizer(gaussians(n=6, degree=1), 1.0), 5)
    kept = torch.tensor([4, 0, 3])
    added = gaussians("nearly flat", n=2, degree=1)
    part.replace(concatenated([part.gaussians.select(kept), added]), kept)
    stepped(whole, 3)
    stepped(part, 3)
    assert len(part.gaussians) == 5
    assert equal(part.gaussians.select(torch.arange(3)), whole.gaussians.select(kept))
    assert not equal(part.gaussians.select(torch.arange(3, 5)), added)


def test_a_restored_optimizer_continues_with_the_same_bits():
    optimizer = stepped(GaussianOptimizer(gaussians(n=6, degree=1), 0.5), 4)
    state = {name: tensor.clone() for name, tensor in optimizer.state().items()}
    again = GaussianOptimizer.restored({**state, "parent": torch.zeros(6)}, 0.5)
    assert equal(stepped(optimizer, 3, 0.5).gaussians, stepped(again, 3, 0.5).gaussians)


def test_an_optimizer_without_steps_is_restored_too():
    g = gaussians(n=6, degree=0)
    fresh = GaussianOptimizer(g, 0.5)
    again = GaussianOptimizer.restored(fresh.state(), 0.5)
    assert equal(stepped(fresh).gaussians, stepped(again).gaussians)


def test_an_incomplete_state_is_refused():
    state = stepped(GaussianOptimizer(gaussians(n=6), 0.5)).state()
    assert len(state) == 9
    for missing in state:
        with pytest.raises(KeyError, match=missing.removeprefix("directional.")):
            GaussianOptimizer.restored({n: t for n, t in state.items() if n != missing}, 0.5)


def test_what_is_far_away_moves_by_pixels_of_its_distance():
    g = gaussians(n=5, degree=0)
    g.means[:, 2] = torch.tensor([8e4, 0, 6e4])
    moved = (stepped(GaussianOptimizer(g, 0.2)).gaussians.means - g.means).abs()
    torch.testing.assert_close(moved[:, 3], torch.full((3,), 0.15 * 0.2), rtol=1e-3, atol=0)
    # 1e5 over the typical distance of 4; along y, Adam sees no gradient.
    torch.testing.assert_close(moved[::2, 2], torch.full((2,), 0.15 * 0.2 * 25000), rtol=1e-3, atol=0)


def test_only_the_chosen_ones_move_and_each_counts_its_own_steps():
    """Chosen every other time, a Gaussian goes where it would have gone by itself in half of the steps."""
    g = gaussians(n=6, degree=1)
    optimizer, alone = GaussianOptimizer(g, 0.3), GaussianOptimizer(g.select(torch.tensor([1, 4])), 0.3)
    for turn in range(8):
        index = torch.tensor([1, 4] if turn % 2 else [0, 2, 3])
        assert optimizer.step(loss_of(optimizer.chosen(index)), 0.2)
    stepped(alone, 4, 0.2)
    assert equal(optimizer.gaussians.select(torch.tensor([5])), g.select(torch.tensor([5])))
    moved = optimizer.gaussians.select(torch.tensor([1, 4]))
    for (_, one), (_, other) in zip(moved.tensors(), alone.gaussians.tensors(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-7)


def test_a_step_is_that_of_torch():
    g = gaussians(n=5, degree=1)
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in g.tensors()}
    rates = {"means": 0.15, "log_scales": 0.1, "rotations": 0.016, "opacity_logits": 0.05}
    adam = torch.optim.Adam(
        [{"params": [leaves[name]], "lr": rate} for name, rate in rates.items()], eps=1e-15
    )
    for _ in range(5):
        adam.zero_grad()
        loss_of(Gaussians(**leaves)).backward()
        adam.step()
    # Positions within the typical distance move by the rate itself.
    moved = stepped(GaussianOptimizer(g, 1.0), 5).gaussians
    for name in rates:
        torch.testing.assert_close(getattr(moved, name), leaves[name].detach(), rtol=1e-5, atol=1e-6)


def test_a_step_of_no_gaussians_is_taken():
    g = gaussians(n=3, degree=1)
    optimizer = GaussianOptimizer(g, 1.0)
    assert optimizer.step(loss_of(optimizer.chosen(torch.zeros(0, dtype=torch.int64))), 0.0)
    assert equal(optimizer.gaussians, g)


def test_moments_exist_only_where_harmonics_do():
    """Those that keep their harmonics go on as if nothing had happened."""
    whole = stepped(GaussianOptimizer(gaussians(n=6, degree=2), 1.0), 5)
    part = stepped(GaussianOptimizer(gaussians(n=6, degree=2), 1.0), 5)
    kept = torch.tensor([False, True, False, False, True, False])
    part.replace(part.gaussians.turning(kept), torch.arange(6))
    state = part.state()
    assert tuple(state["first_moments"].shape) == (14, 6)
    assert tuple(state["directional.first_moments"].shape) == (24, 2)
    for optimizer in (whole, part):
        for _ in range(3):
            optimizer.step(loss_of(optimizer.chosen(torch.tensor([0, 1, 4, 5]))), 0.3)
    assert equal(part.gaussians, whole.gaussians.turning(kept))
    again = GaussianOptimizer.restored(part.state(), 1.0)
    assert equal(stepped(part, 2).gaussians, stepped(again, 2).gaussians)
