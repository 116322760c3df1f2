"""Trains a forest: the finest layer first, then layers by chance, each against frames of its resolution.

Fov-GS, section 3.3, for static scenes. Mended: layer l need only look right at 1 / 2^(L - l) of the
resolution, so that is where it is compared; the coarse layers are nearly free then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from splat.base.arrays import Arrays
from splat.model.building import build_forest
from splat.model.forest import NO_PARENT, Layer, static_layer
from splat.model.settling import settle
from splat.training.density import INITIAL_SHARE
from splat.training.initialization import TrainingView, seed_from_views
from splat.training.layer import LayerTraining, pixel_footprint, reduced
from splat.training.loss import SMALLEST_SIDE

# Share of the steps before there is a forest, and share of the later ones that the finest layer gets: it
# has four times the pixels of the next one, and it is what the viewer sees nearest to the gaze.
_ALONE = 0.4
_FINEST = 0.6
# When density control is over in all layers, and the trees are completed for good.
_SETTLED = 0.8


@dataclass(frozen=True)
class TrainingSettings:
    """How a forest is trained.

    Attributes:
        iterations: optimizer steps, over all layers; one frame each.
        gaussians: how many the finest layer has in the end.
        layers: L; 1 is a set of Gaussians without trees.
        degree: of the spherical harmonics.
        seed: same seed, same forest.

    Raises:
        ValueError: a number is out of range.
    """

    iterations: int = 3000
    gaussians: int = 60_000
    layers: int = 4
    degree: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        if self.iterations <= 0 or self.gaussians <= 0:
            raise ValueError("iterations and gaussians must be positive")
        if self.layers <= 0:
            raise ValueError(f"layers is {self.layers}; a forest must have at least 1")
        if not 0 <= self.degree <= 3:
            raise ValueError(f"degree is {self.degree}; must be 0, 1, 2 or 3")


def most_layers(width: int, height: int) -> int:
    """How many layers frames of this size can train: the coarsest must fill the similarity's window."""
    return max(0, int(np.log2(min(width, height) / SMALLEST_SIDE) + 1)) if min(width, height) else 0


class Trainer:
    """Trains a forest; its whole state can be saved between two steps and restored.

    Args:
        arrays: the backend's array types.
        views: what to learn from, all of one size.
        settings: how.
    """

    def __init__(self, arrays: Arrays, views: list[TrainingView], settings: TrainingSettings):
        self.settings = settings
        self._pixel = pixel_footprint(views)
        self._schedule = _schedule(settings)
        self._layers = [
            LayerTraining(
                arrays,
                [reduced(view, 2 ** (settings.layers - 1 - index)) for view in views],
                max(1, int(np.count_nonzero(self._schedule == index))),
                [settings.seed, index],
            )
            for index in range(settings.layers)
        ]
        self.iteration = 0
        self._settling = int(_SETTLED * settings.iterations)
        rng = np.random.default_rng([settings.seed, 0])
        seeds = seed_from_views(views, max(1, int(settings.gaussians * INITIAL_SHARE)), settings.degree, rng)
        self._layers[-1].begin(static_layer(seeds), settings.gaussians)

    def run(self, progress: Callable[[int], None] = lambda done: None, until: int | None = None) -> None:
        """Trains up to iteration `until`, by default to the end."""
        while self.iteration < (until or self.settings.iterations):
            self._step()
            self.iteration += 1
            progress(self.iteration)

    def forest(self) -> list[Layer]:
        """The layers as they are now, coarsest first, in complete trees."""
        if self._layers[0].density is None:
            return build_forest(self._layers[-1].layer, self._pixel, self.settings.layers)
        layers = [training.layer for training in self._layers]
        return layers if self.iteration > self._settling else settle(layers)

    def _step(self) -> None:
        index = int(self._schedule[self.iteration])
        if index < len(self._layers) - 1 and self._layers[index].density is None:
            self._plant()
        if self.iteration == self._settling and self._layers[0].density is not None:
            settled = settle([training.layer for training in self._layers])
            for training, layer in zip(self._layers, settled, strict=True):
                training.extend(layer)
        moved = self._layers[index].step()
        if moved is not None and index + 1 < len(self._layers) and self._layers[index + 1].density:
            # Children of nodes that are gone look for other parents when the trees are settled.
            below = self._layers[index + 1]
            parent = below.layer.parent.clone()
            known = parent != NO_PARENT
            parent[known] = moved[parent[known].long()]
            below.extend(replace(below.layer, parent=parent))

    def _plant(self) -> None:
        """Builds the forest over the finest layer as it is, and begins with the others."""
        forest = build_forest(self._layers[-1].layer, self._pixel, self.settings.layers)
        self._layers[-1].extend(forest[-1])
        for training, layer in zip(self._layers[:-1], forest[:-1], strict=True):
            training.begin(layer, len(layer))

    def state(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Everything that the next step depends on: tensors, and numbers."""
        tensors: dict[str, torch.Tensor] = {}
        numbers = []
        for index, training in enumerate(self._layers):
            own, counts = training.state()
            tensors |= {f"{index}.{name}": tensor for name, tensor in own.items()}
            numbers.append(counts)
        return tensors, {"iteration": self.iteration, "settings": asdict(self.settings), "layers": numbers}

    def restore(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Inverse of `state`.

        Raises:
            ValueError: the state is that of a training with other settings.
        """
        if numbers["settings"] != asdict(self.settings):
            raise ValueError("the checkpoint is of a training with other settings")
        for index, (training, counts) in enumerate(zip(self._layers, numbers["layers"], strict=True)):
            prefix = f"{index}."
            own = {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}
            training.restore(own, counts)
        self.iteration = int(numbers["iteration"])


def _schedule(settings: TrainingSettings) -> np.ndarray:
    """(iterations,) index of the layer that each step trains."""
    finest = settings.layers - 1
    schedule = np.full(settings.iterations, finest)
    if finest:
        later = int(_ALONE * settings.iterations)
        shares = [(1 - _FINEST) / finest] * finest + [_FINEST]
        rng = np.random.default_rng([settings.seed, 3])
        schedule[later:] = rng.choice(settings.layers, settings.iterations - later, p=shares)
    return schedule
