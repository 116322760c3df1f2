"""Trains a forest: first the finest layer, then randomly chosen layers, each on frames of its resolution.

Fov-GS, section 3.3, for static scenes. Unlike there, layer l is compared at 1 / 2^(L - l) of the resolution,
the only one at which it must look right; this makes the coarse layers nearly free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from compose.base.arrays import Arrays
from compose.base.errors import as_plain_numbers, require_seed
from compose.base.files import under
from splat.model.choices import Labels, MotionModel
from splat.model.dynamic_light import NodeLight, SurfaceLight
from splat.model.forest import Forest
from splat.model.motion import Dynamics, LearnedMotion, NodeMotion
from splat.model.trees import NO_PARENT, Layer, build_forest, settle, without_parents
from splat.training.field_training import FieldOptimizer, register
from splat.training.initialization import seed_from_views
from splat.training.layer_training import LayerTraining
from splat.training.loss import SMALLEST_SIDE
from splat.training.training_view import (
    TrainingView,
    at_resolution,
    finest_focal,
    pixel_footprint,
    place_of,
    placed,
)

# Share of the steps before the forest is built, which takes seconds.
ALONE = 0.5
# Learning rate of the positions of nodes that were merged from finer ones, which are about where they should
# be, over that of seeds.
_MERGED = 0.25
# Share of the steps up to which their number can change: of what is still due, nothing is missed then.
_OPEN = 0.7
# Share of the steps after which density control is finished in all layers and the trees stay as they are.
_SETTLED = 0.8
# Share of the Gaussians that training begins with where distances are guessed.
_GUESSED = 0.3
# Factor between the resolutions of views that count as equally fine.
_ABOUT_AS_FINE = 1.5
# Prefix of a field's tensors in checkpoints.
_FIELD = "field."


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of a training.

    UserError if the seed is out of range; ValueError if a number is out of range.

    Attributes:
        iterations: optimizer steps over all layers, one frame each.
        gaussians: number of Gaussians in the finest layer at the end.
        layers: L; 1 for Gaussians without trees.
        degree: of the spherical harmonics, 0 to 3.
        seed: the same seed gives the same forest; from 0 to compose.base.errors.MOST_SEED.
        motion: how what moves is modelled.
        labels: what tells which pixels move; None to take masks where frames have them.
        all_harmonics: whether Gaussians whose radiance is not seen to turn with the view keep harmonics above
            the constant one.
        half_frames: whether frames are kept in half precision, which holds radiance up to 65,504.
    """

    iterations: int = 3000
    gaussians: int = 40_000
    layers: int = 4
    degree: int = 2
    seed: int = 0
    motion: MotionModel = MotionModel.KNOWN
    labels: Labels | None = None
    all_harmonics: bool = False
    half_frames: bool = False

    def __post_init__(self) -> None:
        as_plain_numbers(self)
        if self.iterations <= 0 or self.gaussians <= 0:
            raise ValueError("iterations and gaussians must be positive")
        if self.layers <= 0:
            raise ValueError(f"layers is {self.layers}; a forest must have at least 1")
        if not 0 <= self.degree <= 3:
            raise ValueError(f"degree is {self.degree}; must be 0, 1, 2 or 3")
        if self.labels is Labels.FLOW and self.motion is not MotionModel.D_GS_OF_DYNAMIC:
            raise ValueError(
                f"labels {self.labels.value} with motion {self.motion.value}: must be with motion "
                f"{MotionModel.D_GS_OF_DYNAMIC.value}; others need no labels, or masks"
            )
        require_seed(self.seed)


def most_layers(width: int, height: int) -> int:
    """Largest number of layers for frames of this size: the coarsest must hold the similarity's window."""
    return max(0, int(np.log2(min(width, height) / SMALLEST_SIDE) + 1)) if min(width, height) else 0


class Trainer:
    """Trains a forest; its whole state can be saved between two steps and restored.

    ValueError if no frame is finite, none shows a surface, or they are too small for the layers.

    Args:
        views: frames to train on, of any sizes, in world space.
        start: whose finest layer to go on from, instead of seeds on the surfaces that the views show.
        motion: of the instances that the views show, in world space; None if nothing moves, and if a field
            learns it.
        light: on the surfaces that they show, in world space; None if it does not change.

    Attributes:
        place: the coordinates in which the Gaussians are trained; motion and light are in them, too.
        dropped: number of frames that were left out, which have numbers that are not finite.
        iteration: steps so far.
    """

    def __init__(
        self,
        arrays: Arrays,
        views: list[TrainingView],
        settings: TrainingSettings,
        start: Forest | None = None,
        motion: NodeMotion | None = None,
        light: SurfaceLight | None = None,
    ):
        self.settings = settings
        finite = [view for view in views if view.is_finite]
        self.dropped = len(views) - len(finite)
        _require_enough(views, finite, settings)
        self.place = place_of(finite) if start is None else start.place
        views = [placed(view, self.place) for view in finite]
        if settings.motion.field is not None:
            # What is deformed is one instance, unless labels tell what is.
            keep = settings.motion is MotionModel.D_GS_OF_DYNAMIC
            whole = lambda view: np.zeros(view.distance.shape, dtype=np.int32)  # noqa: E731
            views = [
                view if keep and view.instance is not None else replace(view, instance=whole(view))
                for view in views
            ]
        self.motion: Dynamics | None = None if motion is None else motion.placed(self.place)
        self.light = None if light is None else light.placed(self.place)
        self._field: FieldOptimizer | None = None
        if settings.motion.field is not None:
            points = np.concatenate([view.points(view.some_surface_pixels) for view in views])
            # The box around the surfaces that views show, the sky apart.
            ends = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.ones(3))
            low, high = (torch.from_numpy(end).float() for end in ends)
            self.motion = learned = LearnedMotion.begun(settings.motion.field, low, high, settings.seed)
            if settings.motion is MotionModel.D_GS_OF_DYNAMIC:
                register(learned, views, settings.iterations, settings.seed)
            self._field = FieldOptimizer(learned, settings.iterations)
        focal = finest_focal(views) / _ABOUT_AS_FINE
        self._pixel = pixel_footprint([view for view in views if view.camera.fy >= focal])
        further = self.motion, self.light, settings.all_harmonics
        self._layers: list[LayerTraining] = []
        self.iteration = 0
        for index, steps in enumerate(self._scheduled()):
            coarser = settings.layers - 1 - index
            images, mobility = at_resolution(views, coarser), _MERGED if coarser else 1.0
            training = LayerTraining(arrays, images, steps, [settings.seed, index], *further, mobility)
            self._layers.append(training)
        rng = np.random.default_rng([settings.seed, 0])
        if start is None:
            lit = None if self.light is None else NodeLight(self.light)
            # Guessed distances are good for a beginning; then the Gaussians themselves tell better ones.
            guessed = any(view.guessed for view in views)
            first = max(1, int(settings.gaussians * (_GUESSED if guessed else 1)))
            known = seed_from_views(views, first, settings.degree, rng, self.motion, lit)
        else:
            known = without_parents(start.layers[-1])
            # All may turn with the view, also those that did not in the earlier training.
            known = replace(known, gaussians=known.gaussians.all_turning())
        self._layers[-1].begin(known, max(settings.gaussians, len(known)))

    def _scheduled(self) -> list[int]:
        """Schedules all steps; returns how many each layer still gets."""
        self._schedule = training_schedule(self.settings)
        self._settling = int(_SETTLED * self.settings.iterations)
        return np.bincount(self._schedule[self.iteration :], minlength=self.settings.layers).tolist()

    def _reschedule(self) -> None:
        for training, steps in zip(self._layers, self._scheduled(), strict=True):
            training.last(training.done + steps)

    @property
    def fewest(self) -> int:
        """Steps in all that there can still be."""
        return math.ceil(self.iteration / _OPEN)

    def last(self, iterations: int) -> None:
        """Makes it so many steps in all.

        ValueError if these are fewer than there can still be, or it is too late for a change.
        """
        if self.fewest > min(iterations, self.settings.iterations):
            raise ValueError(f"after {self.iteration} steps, there cannot be {iterations} in all any more")
        self.settings = replace(self.settings, iterations=iterations)
        self._reschedule()
        if self._field is not None:
            self._field.steps = iterations

    def run(self, progress: Callable[[int], None] = lambda done: None, until: int | None = None) -> None:
        """Trains up to iteration `until`, by default to the end; tells `progress` the steps after each."""
        while self.iteration < (self.settings.iterations if until is None else until):
            self._step()
            self.iteration += 1
            progress(self.iteration)

    @property
    def skipped(self) -> int:
        """Steps so far that changed nothing, because their loss or its gradient was not finite."""
        return sum(training.skipped for training in self._layers)

    def forest(self) -> list[Layer]:
        """The layers as they are now, coarsest first, in complete trees; in the coordinates of `place`."""
        if not self._layers[0].begun:
            return build_forest(self._layers[-1].layer, self._pixel, self.settings.layers)
        layers = [training.layer for training in self._layers]
        return layers if self.iteration > self._settling else settle(layers)

    def _step(self) -> None:
        """Trains the scheduled layer by one step, and keeps the trees up with it."""
        index = int(self._schedule[self.iteration])
        if index < len(self._layers) - 1 and not self._layers[index].begun:
            # Over the finest layer as it is now; the training of the others begins.
            *others, finest = self.forest()
            self._layers[-1].extend(finest)
            for training, layer in zip(self._layers[:-1], others, strict=True):
                training.begin(layer, len(layer))
        if self.iteration == self._settling:
            for number, training in enumerate(self._layers):
                if training.begun:
                    self._tell_children(number, training.separate_at_last())
            if self._layers[0].begun:
                settled = settle([training.layer for training in self._layers])
                for training, layer in zip(self._layers, settled, strict=True):
                    training.extend(layer)
        # Changes would break trees that are settled.
        moved = self._layers[index].step(grows=self.iteration < self._settling)
        if self._field is not None:
            self._field.step(self.iteration, self._layers[index].stepped)
        self._tell_children(index, moved)

    def _tell_children(self, index: int, moved: torch.Tensor | None) -> None:
        """Tells the next layer which index each node of this one has now (N,); None if all have their own."""
        if moved is not None and index + 1 < len(self._layers) and self._layers[index + 1].begun:
            # Children of removed nodes get other parents when the trees are settled.
            below = self._layers[index + 1]
            parent = below.layer.parent.clone()
            known = parent != NO_PARENT
            parent[known] = moved[parent[known].long()]
            below.extend(replace(below.layer, parent=parent))

    def state(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Everything that the next step depends on: tensors, and numbers."""
        parts, numbers = zip(*(training.state() for training in self._layers), strict=True)
        groups = {f"{index}.": part for index, part in enumerate(parts)}
        if self._field is not None:
            groups[_FIELD] = self._field.state()
        tensors = {prefix + name: tensor for prefix, part in groups.items() for name, tensor in part.items()}
        run = {"settings": asdict(self.settings), "origin": list(self.place.origin), "unit": self.place.unit}
        return tensors, {"iteration": self.iteration, **run, "layers": list(numbers)}

    def restore(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Restores what `state` returned.

        ValueError, KeyError if it belongs to a training with other settings, or a part is missing.
        """
        if numbers["settings"] != asdict(self.settings):
            raise ValueError("the checkpoint belongs to a training with other settings")
        if (numbers.get("origin"), numbers.get("unit")) != (list(self.place.origin), self.place.unit):
            raise ValueError("the checkpoint holds Gaussians in other coordinates")
        for index, (training, counts) in enumerate(zip(self._layers, numbers["layers"], strict=True)):
            training.restore(under(f"{index}.", tensors), counts)
        if self._field is not None:
            self._field.restore(under(_FIELD, tensors))
        self.iteration = int(numbers["iteration"])
        # Their number may have changed when some were taken.
        self._reschedule()


def _require_enough(
    views: list[TrainingView], finite: list[TrainingView], settings: TrainingSettings
) -> None:
    if not finite:
        raise ValueError(f"none of {len(views)} frames holds only finite numbers; capture them again")
    finest = [view.camera for view in finite if view.camera.fy == finest_focal(finite)]
    width, height = min(camera.width for camera in finest), min(camera.height for camera in finest)
    if most_layers(width, height) < settings.layers:
        raise ValueError(f"frames of {width} x {height} pixels are too small for {settings.layers} layers")


def training_schedule(settings: TrainingSettings) -> np.ndarray:
    """(iterations,) index of the layer that each step trains; the finest alone, and then all alike."""
    schedule = np.full(settings.iterations, settings.layers - 1)
    later = int(ALONE * settings.iterations)
    rng = np.random.default_rng([settings.seed, 3])
    schedule[later:] = rng.choice(settings.layers, settings.iterations - later)
    return schedule
