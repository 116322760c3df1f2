"""Fitting the fusion to a scene, on views that the splats were not trained on, and trying what it is worth.

The views' radiance is known up to noise, which does not bias the errors against it. Two trial networks are
each fitted to one half of the views and tried on the other. For each cell of sample count, enlargement and
denoiser, the mixture of network, denoised samples and splats with the least error is kept (stacking: Wolpert
1992, Breiman 1996) if it beats the better parent there by more than chance; if it does not, that parent alone
is shown.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from compose.fusion.features import perceived, perceived_slope
from compose.fusion.network import COUNTS, ENLARGEMENTS, MIXED, Cell, Fusion, cell_of, estimated
from compose.fusion.parents import IMAGES, Channels, Parents, as_batch
from compose.image.colour import Image

# Most that one pixel's noise may count for, in perceived radiance: a single path of a rare kind must not
# outweigh a whole patch. What exceeds it is spread over a window of this many pixels, since the light that
# few paths find would otherwise be missing.
_MOST_NOISE = 1.0
_WINDOW = 33
# All images of an example, stacked in one tensor so that patches are cut from all of them at once. Target and
# noise are those of `FusionReference.targets`.
STACK = Channels(
    {"traced": 3, "denoised": 3, "splat": 3, "albedo": 3, "normal": 3, "target": 3, "noise": 3, "count": 1}
)
# Side of a training patch, and least side of an example, in pixels.
LEAST_SIZE = 64
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


@dataclass(frozen=True)
class FusionReference:
    """Noisy radiance of a view from two independent halves of its samples, (H, W, 3) and unbiased each.

    `denoised` is the radiance of the same samples, denoised; biased, but near the truth.
    """

    denoised: Image
    halves: tuple[Image, Image]

    def targets(self) -> tuple[Tensor, Tensor]:
        """Perceived radiance (3, H, W) by the mean of the halves, and half of their difference.

        An estimate x that is independent of the samples has the squared error (x - target)^2 - noise^2 on
        average, whatever the noise is: it is the product of the errors against either half (Lehtinen et al.
        2018). Perceived radiance is linearized at the denoised radiance, so that noise stays unbiased in it.
        """
        base = as_batch(self.denoised)[0].clamp(min=0)
        seen, slope = perceived(base), perceived_slope(base)
        one, other = (seen + _tamed(slope * (as_batch(half)[0] - base)) for half in self.halves)
        return torch.lerp(one, other, 0.5), (one - other) / 2


def _tamed(noise: Tensor) -> Tensor:
    """Noise (3, H, W) without large values, but with the same local mean."""
    kept = noise.clamp(-_MOST_NOISE, _MOST_NOISE)
    excess = (noise - kept)[None]
    if not bool(excess.any()):
        return kept
    # A row's mean and then a column's is the mean of the window, at a fraction of the time.
    for window in ((_WINDOW, 1), (1, _WINDOW)):
        padding = window[0] // 2, window[1] // 2
        excess = functional.avg_pool2d(excess, window, 1, padding, count_include_pad=False)
    return kept + excess[0]


@dataclass(frozen=True)
class Example:
    """A view whose radiance is known up to noise, by a reference that is independent of the parents' samples.

    Parents are as a fovea would have them. Close-ups have the number of their view.
    """

    parents: Parents
    reference: FusionReference
    view: int

    def stack(self) -> Tensor:
        """(STACK.total, H, W) of all images."""
        images = {name: as_batch(getattr(self.parents, name))[0] for name in IMAGES if name in STACK}
        target, noise = self.reference.targets()
        return STACK.stacked({**images, "target": target, "noise": noise})


def fit(
    examples: Sequence[Example], seed: int, progress: Callable[[int, int], None], iterations: int = ITERATIONS
) -> Fusion:
    """A network fitted to examples: it minimizes the mean logarithm of squared errors in perceived radiance.

    Examples are of several views, sample counts and enlargements. Same seed, same network on the same
    machine. `progress` gets the steps done and in all. ValueError without examples of a patch's size.
    """
    if not examples:
        raise ValueError("there are no examples to fit the fusion to")
    if min(*examples[0].parents.traced.shape[:2]) < LEAST_SIZE:
        least = f"{LEAST_SIZE} x {LEAST_SIZE}"
        raise ValueError(f"fitting the fusion requires examples of at least {least} pixels")
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
    top, left = (rng.integers(side - LEAST_SIZE + 1) for side in stack.shape[-2:])
    patch = stack[:, top : top + LEAST_SIZE, left : left + LEAST_SIZE].clone()
    images = STACK.parts(patch)
    telling = float(images["count"][0, 0, 0]) >= _TELLING
    if rng.random() < (_CHANGED if telling else _CHANGED_IN_NOISE):
        images["splat"][:] = _changed(images["splat"], rng)
    if rng.random() < 0.5:
        patch = patch.flip(2)
    return patch.transpose(1, 2) if rng.random() < 0.5 else patch


def _changed(splat: Tensor, rng: np.random.Generator) -> Tensor:
    """Splats (3, H, W) of another world: other light or colour, something moved, turned or in the way."""
    top, left, height, width = 0, 0, LEAST_SIZE, LEAST_SIZE
    if rng.random() < 0.5:
        height, width = (int(n) for n in rng.integers(8, LEAST_SIZE, 2))
        top, left = (int(rng.integers(LEAST_SIZE - side)) for side in (height, width))
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


# Steps of a trial network: enough to tell what the final one will be worth, at less than half of its time.
TRIAL_ITERATIONS = 250
# Trials are compared in blocks of this many pixels, each relative to the better parent's error there: views
# and parts of views in which all errors are large must not decide alone.
_BLOCK = 64
# Least such error, relative to the squared difference of the parents in the block, and to its mean over all
# blocks: the noise of the reference, which that difference does not have, may leave nothing, or less.
_LEAST_ERROR, _LEAST_OF_ALL = 0.25, 0.05
# Share of the better parent's error that a mixture is thought to leave at least, when its gain is stated in
# decibels: the noise of the references hides what is left beyond that.
_LEAST_LEFT = 0.1
# Shares are searched for in steps of 1 / _STEPS.
_STEPS = 20

# Errors of one view in one cell: (B, M, M) products of the errors of what is mixed, mean over each block.
_Errors = NDArray[np.float64]


class Proof(NamedTuple):
    """Shares and gains of `Fusion`; gains are 0 where one parent alone is shown."""

    shares: NDArray[np.float32]
    gains: NDArray[np.float32]


def trials(views: int) -> int:
    """Number of trial networks for a number of views; none if there is only one to learn from and to try."""
    return 2 if views > 1 else 0


def prove(examples: Sequence[Example], seed: int, progress: Callable[[int, int], None]) -> Proof:
    """Finds what to show in each cell, by the examples to which the final network is fitted.

    The seed is that of the trial networks; progress is told the steps done and the steps in total.
    """
    views = sorted({example.view for example in examples})
    halves = [half for half in (set(views[::2]), set(views[1::2])) if half]
    total = TRIAL_ITERATIONS * trials(len(views))
    cells: dict[Cell, dict[int, list[_Errors]]] = defaultdict(lambda: defaultdict(list))
    for number, tried in enumerate(halves):
        learnt = [example for example in examples if example.view not in tried]
        advance = lambda done, _, before=TRIAL_ITERATIONS * number: progress(before + done, total)  # noqa: E731
        # Of a single view, nothing is known about the network, but which parent is better.
        trial = fit(learnt, seed, advance, TRIAL_ITERATIONS) if learnt else Fusion()
        for example in examples:
            if example.view in tried:
                parents = example.parents
                count = float(np.exp(np.log(parents.count).mean()))
                cell = cell_of(parents.quick, count, parents.enlargement)
                cells[cell][example.view].append(_errors(trial, example))
    found = {
        cell: _tried({view: np.concatenate(e) for view, e in of_views.items()})
        for cell, of_views in cells.items()
    }
    shape = 2, len(COUNTS), len(ENLARGEMENTS)
    shares, gains = np.zeros((*shape, len(MIXED)), np.float32), np.zeros(shape, np.float32)
    for index in np.ndindex(shape):
        # Where nothing was tried, as in the nearest cell: the denoiser matters least, the enlargement most.
        nearest = min(found, key=lambda cell: tuple(np.abs(np.subtract(cell, index))[::-1]))
        shares[index], gains[index] = found[nearest]
    return Proof(shares, gains)


def _errors(fusion: Fusion, example: Example) -> _Errors:
    """Unbiased products of errors in perceived radiance."""
    stack = example.stack()[None]
    with torch.inference_mode():
        height, width = (side - side % 2 for side in stack.shape[-2:])
        images = STACK.parts(stack[..., :height, :width])
        mixed = estimated(fusion, images, [example.parents])[0], images["denoised"], images["splat"]
        errors = torch.cat([perceived(image.clamp(min=0)) - images["target"] for image in mixed])
        products = torch.einsum("ichw,jchw->ijhw", errors, errors) / 3
        products = products - (images["noise"] ** 2).mean(1)
    rows, columns = (np.arange(0, max(side - _BLOCK // 2, 1), _BLOCK) for side in (height, width))
    sums = np.add.reduceat(products.double().numpy(), rows, axis=2)
    sums = np.add.reduceat(sums, columns, axis=3)
    areas = np.outer(np.diff([*rows, height]), np.diff([*columns, width]))
    return np.ascontiguousarray((sums / areas).reshape(len(MIXED), len(MIXED), -1).transpose(2, 0, 1))


def _tried(of_views: dict[int, _Errors]) -> tuple[NDArray[np.float64], float]:
    """Shares in one cell, and their gain over the better parent in decibels."""
    # Errors of each view over the better parent's in each block.
    apart = {view: e[:, 1, 1] + e[:, 2, 2] - 2 * e[:, 1, 2] for view, e in of_views.items()}
    floor = max(_LEAST_OF_ALL * float(np.concatenate(list(apart.values())).mean()), 1e-9)
    scaled = {}
    for view, e in of_views.items():
        better = np.minimum(e[:, 1, 1], e[:, 2, 2])
        scale = np.maximum(np.maximum(better, _LEAST_ERROR * apart[view]), floor)
        scaled[view] = e / scale[:, None, None]
    mean = np.concatenate(list(scaled.values())).mean(axis=0)  # (M, M)
    parent = int(np.argmin([mean[1, 1], mean[2, 2]])) + 1
    alone = np.eye(len(MIXED))[parent]
    if len(scaled) < 2:
        return alone, 0.0
    # Each view is judged by shares that the other ones have chosen.
    gains, left = [], []
    for view, errors in scaled.items():
        others = np.concatenate([one for name, one in scaled.items() if name != view])
        chosen = _best(others.mean(axis=0))
        gains.append((errors[:, parent, parent] - _squared(errors, chosen)).mean())
        left.append(_squared(of_views[view], chosen))
    if np.mean(gains) <= np.std(gains, ddof=1) / np.sqrt(len(gains)):
        return alone, 0.0
    # Relative errors decide what is shown, but noise biases them, and hardly these.
    errors = np.concatenate(list(of_views.values())).mean(axis=0)
    least = max(float(errors.diagonal()[1:].min()), 0) + INVISIBLE
    rest = max(float(np.concatenate(left).mean()) + INVISIBLE, _LEAST_LEFT * least)
    return _best(mean), float(10 * np.log10(least / rest))


def _best(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M,) shares with the least squared error, by mean products of errors (M, M)."""
    steps = range(_STEPS + 1)
    grid = np.array([(a, b, _STEPS - a - b) for a in steps for b in steps if a + b <= _STEPS]) / _STEPS
    return grid[np.argmin(_squared(mean, grid))]


def _squared(products: NDArray[np.float64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared errors of mixtures: of one in (B, M, M) blocks, or of (S, M) in one."""
    return np.asarray(np.einsum("...i,...ij,...j->...", shares, products, shares))
