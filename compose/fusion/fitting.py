"""Fitting the fusion to a scene, on views that the splats were not trained on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from compose.fusion.estimate import estimated
from compose.fusion.examples import STACK, Example
from compose.fusion.features import perceived
from compose.fusion.network import Fusion
from compose.fusion.parents import Parents

# Side of a training patch, and least side of an example, in pixels.
LEAST_SIZE = _PATCH = 64
ITERATIONS = 600
_BATCH = 6
_RATE = 4e-3
# Share of patches whose splats are made wrong, so that the network learns to notice a world that has changed.
# Fewer samples than _TELLING cannot tell a change from noise; learning to see changes in them would make it
# see some everywhere.
_CHANGED = 0.25
_CHANGED_IN_NOISE = 0.05
_TELLING = 4
# Least squared error that a patch is thought to have: relative to the reference's noise, which hides smaller
# ones, and as one that nobody sees; else black patches would outweigh all others.
_CERTAINTY = 0.05
INVISIBLE = 1e-5
# Errors count as they are and as means over squares of this many pixels: at arm's length from a monitor, the
# eye sees waves of about eight pixels best, and blotches more easily than as much noise in single pixels.
_SIDES = 1, 4


def fit(
    examples: Sequence[Example],
    seed: int,
    progress: Callable[[int, int], None],
    iterations: int = ITERATIONS,
) -> Fusion:
    """A network fitted to examples: it minimizes the mean logarithm of squared errors in perceived radiance.

    Args:
        examples: of several views, sample counts and enlargements.
        seed: same seed, same network on the same machine.
        progress: called with steps done and steps in all.
        iterations: number of steps.

    Raises:
        ValueError: there are no examples, or they are smaller than a patch.
    """
    if not examples:
        raise ValueError("there are no examples to fit the fusion to")
    if min(*examples[0].parents.traced.shape[:2]) < _PATCH:
        raise ValueError(f"fitting the fusion requires examples of at least {_PATCH} x {_PATCH} pixels")
    rng = np.random.default_rng(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        fusion = Fusion()
    optimizer = torch.optim.Adam(fusion.parameters(), lr=_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, iterations)
    stacks = [example.stack() for example in examples]
    for step in range(iterations):
        picks = [int(rng.integers(len(examples))) for _ in range(_BATCH)]
        patches = torch.stack([_patch(stacks[pick], rng) for pick in picks])
        loss = _loss(fusion, patches, [examples[pick].parents for pick in picks])
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(fusion.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        progress(step + 1, iterations)
    return fusion.requires_grad_(False).eval()


def _loss(fusion: Fusion, patches: Tensor, parents: Sequence[Parents]) -> Tensor:
    """Mean squared error of patches (N, STACK.total, H, W) and of means within them, relative to what it is.

    Its gradient is that of the logarithm of the error without the reference's noise.
    """
    images = STACK.parts(patches)
    radiance, _ = estimated(fusion, images, parents)
    difference, noise = perceived(radiance) - images["target"], images["noise"]
    parts = []
    for side in _SIDES:
        error, unknown = (
            (functional.avg_pool2d(image, side) ** 2).mean((1, 2, 3)) for image in (difference, noise)
        )  # (N,) each
        without = torch.maximum(error.detach() - unknown, _CERTAINTY * unknown) + INVISIBLE
        parts.append((error / without).mean())
    return torch.stack(parts).mean()


def _patch(stack: Tensor, rng: np.random.Generator) -> Tensor:
    """A random part of an example, mirrored and transposed at random, sometimes with wrong splats."""
    height, width = stack.shape[-2:]
    top, left = rng.integers(height - _PATCH + 1), rng.integers(width - _PATCH + 1)
    patch = stack[:, top : top + _PATCH, left : left + _PATCH].clone()
    images = STACK.parts(patch)
    telling = float(images["count"][0, 0, 0]) >= _TELLING
    if rng.random() < (_CHANGED if telling else _CHANGED_IN_NOISE):
        images["splat"][:] = _changed(images["splat"], rng)
    if rng.random() < 0.5:
        patch = patch.flip(2)
    return patch.transpose(1, 2) if rng.random() < 0.5 else patch


def _changed(splat: Tensor, rng: np.random.Generator) -> Tensor:
    """Splats (3, H, W) of another world: other light or colour, something moved, turned or in the way."""
    top, left, height, width = 0, 0, _PATCH, _PATCH
    if rng.random() < 0.5:
        height, width = (int(n) for n in rng.integers(8, _PATCH, 2))
        top, left = int(rng.integers(_PATCH - height)), int(rng.integers(_PATCH - width))
    colour = lambda values: torch.tensor(values, dtype=torch.float32).view(-1, 1, 1)  # noqa: E731
    kinds: list[Callable[[], Tensor]] = [
        lambda: splat * float(np.exp(rng.uniform(-1.5, 1.2))),
        lambda: splat * colour(np.exp(rng.normal(0, 0.5, 3))),
        lambda: torch.roll(splat, tuple(int(n) for n in rng.integers(3, 30, 2)), (1, 2)),
        lambda: splat.flip(1).flip(2),
        lambda: colour(rng.uniform(0, 1, 3) ** 2).expand_as(splat),
    ]
    other = kinds[rng.integers(len(kinds))]()
    result = splat.clone()
    box = np.s_[:, top : top + height, left : left + width]
    result[box] = other[box]
    return result
