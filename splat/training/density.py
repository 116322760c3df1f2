"""Density control: where the picture is wrong Gaussians are added, those that nobody sees go.

3D Gaussian splatting infers from gradients where Gaussians are missing, because it has no geometry. Here
the path tracer knows the distance of every pixel: new ones are placed right there, at pixels drawn in
proportion to their error.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from splat.model.gaussians import Gaussians, concatenated
from splat.training.initialization import TrainingView, seed_at

INITIAL_SHARE = 0.5  # of the final number of the finest layer
_EVERY = 100  # iterations
_FIRST, _LAST = 0.05, 0.6  # shares of the training between which the number changes
_MINIMUM_OPACITY = 0.02
_SIZE = 0.6  # standard deviation of an added Gaussian in pixels


class DensityControl:
    """Decides when and how the set of Gaussians changes.

    Args:
        iterations: length of the training.
        initial_count: how many Gaussians it begins with.
        final_count: how many there shall be in the end.
    """

    def __init__(self, iterations: int, initial_count: int, final_count: int):
        self.iterations, self.initial_count, self.final_count = iterations, initial_count, final_count
        self._errors: dict[int, torch.Tensor] = {}

    def observe(self, view: int, error: torch.Tensor) -> None:
        """Remembers a view's latest error per pixel (H, W)."""
        self._errors[view] = error

    def is_due(self, iteration: int) -> bool:
        """Whether the number changes after this iteration."""
        share = iteration / self.iterations
        return iteration % _EVERY == _EVERY - 1 and _FIRST <= share <= _LAST

    def change(
        self, gaussians: Gaussians, views: list[TrainingView], rng: np.random.Generator
    ) -> tuple[torch.Tensor, Gaussians]:
        """Indices (M,) of the Gaussians that stay, and new ones."""
        opacity = torch.sigmoid(gaussians.opacity_logits)
        finite = torch.isfinite(gaussians.means).all(dim=0) & torch.isfinite(gaussians.log_scales).all(dim=0)
        kept = torch.nonzero((opacity >= _MINIMUM_OPACITY) & finite)[:, 0]
        # Towards the final number in equal steps, whatever was pruned.
        rounds = max(1, int((_LAST - _FIRST) * self.iterations / _EVERY))
        step = -(-(self.final_count - self.initial_count) // rounds)
        target = min(self.final_count, len(gaussians) + step)
        return kept, self._added(target - len(kept), views, gaussians.degree, rng)

    def _added(
        self, count: int, views: list[TrainingView], degree: int, rng: np.random.Generator
    ) -> Gaussians:
        seen = sorted(self._errors)
        # A little for every view: where nothing is wrong anywhere, the shares are equal, not 0 / 0.
        weights = np.array([float(self._errors[v].mean()) for v in seen]) + 1e-9
        shares = rng.multinomial(max(0, count), weights / weights.sum())
        parts = [
            seed_at(views[view], _draw(self._errors[view], views[view], int(share), rng), _SIZE, degree)
            for view, share in zip(seen, shares, strict=True)
        ]
        return concatenated(parts)

    def state(self) -> dict[str, torch.Tensor]:
        """What must be saved with a checkpoint."""
        return {f"error.{view}": error for view, error in self._errors.items()}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Inverse of `state`."""
        self._errors = {
            int(name.split(".")[1]): tensor for name, tensor in tensors.items() if name.startswith("error.")
        }


def _draw(error: torch.Tensor, view: TrainingView, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices of pixels that show a surface, drawn without repetition in proportion to their error."""
    weights = error.numpy().ravel().astype(np.float64)
    weights[~np.isfinite(view.distance.ravel())] = 0
    possible = int(np.count_nonzero(weights))
    if not possible:
        return np.zeros(0, dtype=np.int64)
    return rng.choice(weights.size, min(count, possible), replace=False, p=weights / weights.sum())
