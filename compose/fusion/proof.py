"""What a fusion is worth on views that it has not seen.

Two trial networks are each fitted to one half of the views and tried on the other. For each cell of sample
count, enlargement and denoiser, the mixture of network, denoised samples and splats with the least error is
kept (stacking: Wolpert 1992, Breiman 1996) if it beats the better parent there by more than chance; if it
does not, that parent alone is shown.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from compose.fusion.features import perceived
from compose.fusion.fitting import INVISIBLE, STACK, Example, fit
from compose.fusion.network import COUNTS, ENLARGEMENTS, MIXED, Cell, Fusion, cell_of, estimated

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
    """What is shown in each cell.

    Shares (2, len(COUNTS), len(ENLARGEMENTS), len(MIXED)) are those of network, denoised samples and splats;
    gains are decibels by which the mixture's squared error was below the better parent's on unseen views, 0
    where that parent alone is shown.
    """

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
    return _proof({cell: {view: np.concatenate(e) for view, e in of.items()} for cell, of in cells.items()})


def _errors(fusion: Fusion, example: Example) -> _Errors:
    """(B, M, M) unbiased products of errors in perceived radiance, mean over each block of an example."""
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


def _proof(cells: dict[Cell, dict[int, _Errors]]) -> Proof:
    """What to show in all cells; those in which nothing was tried get what the nearest one gets."""
    found = {cell: _tried(of_views) for cell, of_views in cells.items()}
    shape = 2, len(COUNTS), len(ENLARGEMENTS)
    shares, gains = np.zeros((*shape, len(MIXED)), np.float32), np.zeros(shape, np.float32)
    for index in np.ndindex(shape):
        # How far cells are: the denoiser matters least, the enlargement most.
        nearest = min(found, key=lambda cell: tuple(np.abs(np.subtract(cell, index))[::-1]))
        shares[index], gains[index] = found[nearest]
    return Proof(shares, gains)


def _tried(of_views: dict[int, _Errors]) -> tuple[NDArray[np.float64], float]:
    """Shares in one cell, and their gain over the better parent in decibels."""
    scaled = _relative(of_views)
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
    return _best(mean), _decibels(np.concatenate(list(of_views.values())), np.concatenate(left))


def _decibels(errors: _Errors, left: NDArray[np.float64]) -> float:
    """How much less than the better parent's error (B, M, M) is left (B,).

    Relative errors decide what is shown, but noise biases them, and hardly these.
    """
    parent = max(float(errors.mean(axis=0).diagonal()[1:].min()), 0) + INVISIBLE
    return float(10 * np.log10(parent / max(float(left.mean()) + INVISIBLE, _LEAST_LEFT * parent)))


def _relative(of_views: dict[int, _Errors]) -> dict[int, _Errors]:
    """Errors (B, M, M) of each view over the better parent's in each block."""
    apart = {view: e[:, 1, 1] + e[:, 2, 2] - 2 * e[:, 1, 2] for view, e in of_views.items()}
    floor = max(_LEAST_OF_ALL * float(np.concatenate(list(apart.values())).mean()), 1e-9)
    found = {}
    for view, e in of_views.items():
        better = np.minimum(e[:, 1, 1], e[:, 2, 2])
        scale = np.maximum(np.maximum(better, _LEAST_ERROR * apart[view]), floor)
        found[view] = e / scale[:, None, None]
    return found


def _best(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M,) shares with the least squared error, by mean products of errors (M, M)."""
    steps = range(_STEPS + 1)
    grid = np.array([(a, b, _STEPS - a - b) for a in steps for b in steps if a + b <= _STEPS]) / _STEPS
    return grid[np.argmin(_squared(mean, grid))]


def _squared(products: NDArray[np.float64], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared errors of mixtures: of one in (B, M, M) blocks, or of (S, M) in one."""
    return np.asarray(np.einsum("...i,...ij,...j->...", shares, products, shares))
