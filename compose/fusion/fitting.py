"""Fitting the fusion to a scene, on views that the splats were not trained on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from compose.fusion.features import features_of, perceived
from compose.fusion.maps import as_batch
from compose.fusion.network import Fusion, mixture
from compose.fusion.parents import Parents

# Side of what is looked at at once, and least side of an example, in pixels.
LEAST_SIZE = _PATCH = 64
ITERATIONS = 1200
_BATCH = 6
_RATE = 4e-3
# Share of patches whose splats are made wrong: a world that has changed must be noticed. Fewer samples than
# these cannot tell a change from noise, and learning to see changes in them would see some everywhere.
_CHANGED = 0.25
_CHANGED_IN_NOISE = 0.05
_TELLING = 4
# What a stack holds, in channels.
_CHANNELS = [3, 3, 3, 3, 3, 3, 1]


@dataclass(frozen=True)
class Example:
    """A view of which the truth is known.

    Attributes:
        parents: as a fovea would have them.
        reference: (H, W, 3) converged radiance.
    """

    parents: Parents
    reference: np.ndarray


def fit(examples: Sequence[Example], seed: int, progress: Callable[[int, int], None]) -> Fusion:
    """A fusion with the least mean logarithm of squared errors, in perceived radiance, over patches.

    Args:
        examples: of several views, sample counts and enlargements.
        seed: same seed, same fusion on the same machine.
        progress: called with steps done and steps in all.

    Raises:
        ValueError: there is nothing to fit to, or pictures are smaller than a patch.
    """
    if not examples:
        raise ValueError("there are no examples to fit the fusion to")
    if min(*examples[0].reference.shape[:2]) < _PATCH:
        raise ValueError(f"pictures of at least {_PATCH} x {_PATCH} pixels are needed to fit the fusion")
    rng = np.random.default_rng(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        fusion = Fusion()
    optimizer = torch.optim.Adam(fusion.parameters(), lr=_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, ITERATIONS)
    stacks = [_stack(example) for example in examples]
    for step in range(ITERATIONS):
        picks = [int(rng.integers(len(examples))) for _ in range(_BATCH)]
        patches = torch.stack([_patch(stacks[pick], rng) for pick in picks])
        enlargement = torch.tensor([float(examples[pick].parents.enlargement) for pick in picks])
        *images, reference, count = patches.split(_CHANNELS, dim=1)
        features = features_of(images, count, enlargement)
        radiance, _ = mixture(fusion(features), images[:3], features.texture)
        error = ((perceived(radiance) - perceived(reference)) ** 2).mean((1, 2, 3))
        loss = torch.log(error + 1e-6).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(fusion.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        progress(step + 1, ITERATIONS)
    return fusion.requires_grad_(False).eval()


def _stack(example: Example) -> Tensor:
    """(19, H, W): the parents' images, the reference and the count of samples."""
    parents = example.parents
    images = (
        *(parents.traced, parents.denoised, parents.splat, parents.albedo, parents.normal),
        *(example.reference, parents.count),
    )
    return torch.cat([as_batch(image)[0] for image in images])


def _patch(stack: Tensor, rng: np.random.Generator) -> Tensor:
    """A part of an example, mirrored and turned at random, now and then with splats that are wrong."""
    height, width = stack.shape[-2:]
    top, left = rng.integers(height - _PATCH + 1), rng.integers(width - _PATCH + 1)
    patch = stack[:, top : top + _PATCH, left : left + _PATCH].clone()
    telling = float(patch[-1, 0, 0]) >= _TELLING
    if rng.random() < (_CHANGED if telling else _CHANGED_IN_NOISE):
        patch[6:9] = _changed(patch[6:9], rng)
    if rng.random() < 0.5:
        patch = patch.flip(2)
    return patch.transpose(1, 2) if rng.random() < 0.5 else patch


def _changed(splat: Tensor, rng: np.random.Generator) -> Tensor:
    """A picture of another world: other light, another colour, something moved, turned or in the way."""
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
