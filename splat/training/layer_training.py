"""Training of one layer of a forest: its frames and their order, Gaussians, harmonics, density control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compose.base.arrays import Arrays
from compose.camera.camera import View
from splat.model.dynamic_light import NodeLight, SurfaceLight
from splat.model.gaussians import SH_DC, Gaussians, apart
from splat.model.motion import Dynamics, LearnedMotion
from splat.model.trees import LABELS, NO_PARENT, Layer, concatenated_layers
from splat.raster.differentiable import contributions, directional_radiance, render_differentiable, visible
from splat.training.density import LEAST_STEPS, DensityControl, halves, largest_log_scales, too_large
from splat.training.depth_estimates import measured
from splat.training.gaussian_optimizer import HOST, GaussianOptimizer
from splat.training.loss import FrameTarget
from splat.training.moving_nodes import LEAST_PIXELS, Evidence, evidence_of, separated
from splat.training.training_view import TrainingView, pixel_footprint

# Of an average view's share, what every view gets whatever its error, which others may make larger meanwhile.
_FLOOR = 0.25


def order_of_views(errors: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """(V,) views of a round of V steps, in random order; a view may be among them several times, or not.

    How often differs by less than 1 from what is in proportion to its error and a floor. An error that is not
    known, NaN, counts as average.
    """
    count = len(errors)
    known = errors[np.isfinite(errors)]
    average = known.mean() if len(known) and known.mean() > 0 else 1.0
    weights = np.where(np.isfinite(errors), errors, average) + _FLOOR * average
    views = rng.permutation(count)
    # Systematic sampling: evenly spaced marks on the weights laid end to end.
    ends = np.cumsum(weights[views])
    marks = (np.arange(count) + rng.random()) * (ends[-1] / count)
    return rng.permutation(views[np.minimum(np.searchsorted(ends, marks, side="right"), count - 1)])


# Steps from one look at the sizes to the next.
_LIMITED_EVERY = 25
# And from one look at which points of surfaces nodes have their light from.
_LIT_EVERY = 100
# How often nodes are told anew which of them move; views from which, at most, and as a share of the steps.
_SEPARATIONS, _SEPARATING_VIEWS, _SEPARATING_SHARE = 8, 32, 0.2
# When it is told which nodes turn with the view, as shares of the steps, and by what share of what is visible
# they must: while there are few, and at last when the others can still make up for what goes.
_TURNING = {0.3: 0.2, 0.8: 1.0}
# Views that tell it, half as large along each side: as a share of the steps, and their least and greatest
# number.
_TURNING_SHARE, _TURNING_VIEWS = 0.1, (8, 32)


class LayerTraining:
    """Trains one layer; its whole state can be saved between two steps and restored.

    Args:
        views: frames at this layer's resolution.
        seed: determines the order of the views and the new Gaussians.
        motion, light: as for `Trainer`, in the coordinates of the views.
        all_harmonics: as in `TrainingSettings`.
        mobility: learning rate of positions, over that of seeds.

    Attributes:
        done, skipped: steps so far, and those that changed nothing: their loss or gradient was not finite.
        stepped, begun: whether the last one changed something, and whether the layer has nodes.
    """

    _tree: Layer
    _optimizer: GaussianOptimizer
    _density: DensityControl
    # Views of the round of steps that is under way.
    _order: torch.Tensor

    def __init__(
        self,
        arrays: Arrays,
        views: list[TrainingView],
        steps: int,
        seed: list[int],
        motion: Dynamics | None = None,
        light: SurfaceLight | None = None,
        all_harmonics: bool = False,
        mobility: float = 1.0,
    ):
        self._motion, self._all_harmonics = motion, all_harmonics
        self._light = None if light is None else NodeLight(light)
        self.views, self.done, self.skipped, self.begun, self.stepped = views, 0, 0, False, False
        self._arrays, self._steps, self._seed = arrays, max(1, steps), seed
        # What moves, and light that changes, are shown on the host.
        still = motion is None and light is None
        self._device = arrays.device if still else HOST
        self._targets = [FrameTarget(arrays, torch.from_numpy(v.radiance).to(self._device)) for v in views]
        self._pixel = mobility * pixel_footprint(views)
        labels = [view.instance for view in views if view.instance is not None]
        self._instances = 1 + max((int(label.max()) for label in labels), default=-1)
        # Where all or nothing moves, there is nothing to tell; labels of known courses are exact.
        partly = any(bool((label < 0).any()) for label in labels)
        self._separates = isinstance(motion, LearnedMotion) and self._instances > 0 and partly

    def begin(self, layer: Layer, final_count: int) -> None:
        """Starts from the given nodes; density control brings their number to the final one."""
        self._tree, self.begun = layer, True
        self._optimizer = GaussianOptimizer(layer.gaussians, self._pixel, self._device)
        self._density = DensityControl(self._steps, len(layer), final_count, self._motion, self._light)
        self._follow_light()

    def _follow_light(self) -> None:
        if self._light is not None:
            self._light.follow(self.layer)

    def last(self, steps: int) -> None:
        """Makes it so many steps in all, one at least."""
        self._steps = max(1, steps)
        if self.begun:
            self._density.iterations = self._steps

    def extend(self, layer: Layer) -> None:
        """Continues with the same nodes, possibly with other parents, and with new nodes after them."""
        before = len(self._tree)
        self._tree = layer
        if len(layer) > before:
            self._optimizer.replace(layer.gaussians, torch.arange(before))
        self._follow_light()

    @property
    def layer(self) -> Layer:
        """The nodes as they are now, without gradients."""
        return replace(self._tree, gaussians=self._optimizer.gaussians)

    def step(self, grows: bool = True) -> torch.Tensor | None:
        """Takes one optimizer step on one frame; if the layer `grows`, density control may change its nodes.

        If it did, returns (N,) the index that each former node has now, -1 if it was removed.
        """
        index = self._view_of(self.done)
        camera, time = self.views[index].camera, self.views[index].time
        semantic = self._tree.semantic
        own = self._optimizer.on_device if self._motion is None else self._shown(time)
        shown = visible(self._arrays, own, camera)
        rest = chosen = self._optimizer.chosen(shown)
        if self._motion is not None:
            chosen = self._motion.shown(rest, semantic[shown], time)
        if self._light is not None:
            chosen = self._light.lit(rest, chosen, shown, camera, time)
        image = render_differentiable(self._arrays, chosen, camera)
        loss, error = self._targets[index].loss(image)
        self.stepped = self._optimizer.step(loss, self.done / self._steps)
        if self.stepped:
            self._density.observe(index, error.to(HOST))
        else:
            self.skipped += 1
        if self.done % _LIMITED_EVERY == _LIMITED_EVERY - 1:
            means = self._optimizer.gaussians.means
            self._optimizer.limit_scales(largest_log_scales(means, self.views))
        due = grows and self._density.is_due(self.done)
        every = max(1, self._steps // _SEPARATIONS)
        if grows and self.done % every == every - 1:
            self.separate(min(_SEPARATING_VIEWS, int(np.ceil(_SEPARATING_SHARE * every))))
        self.done += 1
        now = self._change_density() if due else None
        turns = self._optimizer.gaussians.degree and not self._all_harmonics
        for share, least in _TURNING.items():
            if turns and self.done == int(share * self._steps):
                self._keep_turning(least)
        if due or self.done % _LIT_EVERY == 0:
            self._follow_light()
        return now

    def separate(self, count: int) -> None:
        """Tells anew which nodes move, from at most a number of views (Fov-GS, section 3.3)."""
        if self._separates:
            count = min(len(self.views), count)
            chosen = np.random.default_rng([*self._seed, 3, self.done]).choice(len(self.views), count, False)
            self._separate([self.views[index] for index in sorted(chosen)])

    def separate_at_last(self) -> torch.Tensor | None:
        """Tells from all views which nodes move, and removes those that move and that none of them shows.

        A field has led these behind something. Returns as `step`.
        """
        if not self._separates:
            return None
        evidence = self._separate(self.views)
        kept = torch.nonzero((evidence.seen >= LEAST_PIXELS) | ~self._tree.dynamic)[:, 0]
        if len(kept) in (0, len(self._tree)):
            return None
        now = self._continue_with(kept, [])
        self._follow_light()
        return now

    def _separate(self, views: list[TrainingView]) -> Evidence:
        assert self._motion is not None
        views = [self._measured(view) for view in views]
        evidence = evidence_of(self._arrays, self.layer, views, self._motion, self._instances)
        self._tree = separated(self.layer, evidence, self._motion)
        self._optimizer.replace(self._tree.gaussians, torch.arange(len(self._tree)))
        return evidence

    def _keep_turning(self, least: float) -> None:
        """Leaves harmonics to those nodes whose radiance is seen to turn, by a share of what is visible."""
        count = min(len(self.views), int(np.clip(_TURNING_SHARE * self._steps, *_TURNING_VIEWS)))
        chosen = np.random.default_rng([*self._seed, 4]).choice(len(self.views), count, False)
        views = []
        for index in sorted(chosen):
            camera = self.views[index].camera
            whole = View(camera, self.views[index].time)
            views.append(whole.resized(camera.width // 2, camera.height // 2))
        gaussians = without_unseen_turning(self._arrays, self._optimizer.gaussians, views, self._shown, least)
        self._tree = replace(self._tree, gaussians=gaussians)
        self._optimizer.replace(gaussians, torch.arange(len(gaussians)))

    def _change_density(self) -> torch.Tensor:
        """Removes and adds nodes; returns as `step`."""
        rng = np.random.default_rng([*self._seed, 1, self.done])
        before = self.layer
        kept, added = self._density.change(before.gaussians, self.views, rng, self._measured)
        added = replace(added, gaussians=turning_as_nearest(added.gaussians, before.gaussians))
        if self._light is not None and self._steps >= LEAST_STEPS:
            # Halves of those nodes that are too large for their light.
            staying = before.select(kept)
            large = too_large(staying, self._light.surface, self.views)
            kept, added = kept[~large], concatenated_layers([added, halves(staying.select(large))])
        return self._continue_with(kept, [added])

    def _continue_with(self, kept: torch.Tensor, added: list[Layer]) -> torch.Tensor:
        """Continues with nodes of an index and others after them; returns as `step`."""
        before = self.layer
        self._tree = concatenated_layers([before.select(kept), *added])
        self._optimizer.replace(self._tree.gaussians, kept)
        now = torch.full((len(before),), NO_PARENT, dtype=torch.int32)
        now[kept] = torch.arange(len(kept), dtype=torch.int32)
        return now

    def _measured(self, view: TrainingView) -> TrainingView:
        """The view, with the distances that the nodes show now if nobody knows them."""
        return measured(self._arrays, self._shown(view.time), view) if view.guessed else view

    def _shown(self, time: float) -> Gaussians:
        gaussians = self._optimizer.gaussians
        if self._motion is None:
            return gaussians
        with torch.no_grad():
            return self._motion.shown(gaussians, self._tree.semantic, time)

    def _view_of(self, step: int) -> int:
        """The view of a step: in the first round each one once, later in proportion to their errors."""
        turn, position = divmod(step, len(self.views))
        if position == 0:
            rng = np.random.default_rng([*self._seed, 2, turn])
            self._order = torch.from_numpy(order_of_views(self._density.view_errors(len(self.views)), rng))
        return int(self._order[position])

    def state(self) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Everything that the next step depends on: tensors, and numbers."""
        if not self.begun:
            return {}, {"done": 0}
        counts = {"initial": self._density.initial_count, "final": self._density.final_count}
        tensors = dict(self._tree.labels()) | self._optimizer.state() | self._density.state()
        tensors |= {"order": self._order} if self.done else {}
        tensors |= {} if self._light is None else self._light.state()
        return tensors, {"done": self.done, "skipped": self.skipped, **counts}

    def restore(self, tensors: dict[str, torch.Tensor], numbers: dict[str, Any]) -> None:
        """Restores what `state` returned; KeyError if a tensor or a number is missing."""
        if "initial" not in numbers:
            return
        self._optimizer, self.begun = GaussianOptimizer.restored(tensors, self._pixel, self._device), True
        self._tree = Layer(self._optimizer.gaussians, *(tensors[name] for name in LABELS))
        counts = int(numbers["initial"]), int(numbers["final"])
        self._density = DensityControl(self._steps, *counts, self._motion, self._light)
        if self._light is not None:
            self._light.restore(tensors)
        self._density.restore(tensors)
        self.done, self.skipped = int(numbers["done"]), int(numbers["skipped"])
        if self.done:
            self._order = tensors["order"]


# Standard deviation over views, on the perceptual scale, that a Gaussian's radiance must have to keep
# harmonics above the constant one: one step of an 8-bit display. Others would use them to fit noise.
_LEAST_DEVIATION = 1 / 255


def turning_of(
    arrays: Arrays, gaussians: Gaussians, views: Sequence[View], shown: Callable[[float], Gaussians]
) -> tuple[torch.Tensor, torch.Tensor]:
    """How those M Gaussians turn that have harmonics above the constant one; 0 of what no view shows.

    Returns (3, M) what these harmonics add, mean over views, by what each view shows; and (M,) the root of
    its variance over views, of the channel that varies most. `shown` gives the Gaussians as at some time.
    """
    further = gaussians.directional
    assert further is not None
    total = torch.zeros(len(further))
    first, second = (torch.zeros(3, len(further)) for _ in range(2))
    for view in views:
        camera, now = view.camera, shown(view.time)
        pixels = np.ones((camera.height, camera.width, 1), np.float32)
        weight = contributions(arrays, now, camera, pixels)[further.index, 0]
        radiance = directional_radiance(further, now.means, camera.position)
        total += weight
        first += weight * radiance
        second += weight * radiance.square()
    seen = total > 0
    share = torch.where(seen, 1 / total.clamp(min=1e-30), 0)
    mean = first * share
    variance = (second * share - mean.square()).clamp(min=0)
    return mean, variance.amax(dim=0).sqrt()


def without_unseen_turning(
    arrays: Arrays,
    gaussians: Gaussians,
    views: Sequence[View],
    shown: Callable[[float], Gaussians],
    least: float = 1.0,
) -> Gaussians:
    """Gaussians, of which only those whose radiance visibly turns keep harmonics above the constant one.

    `least` is the share of what is visible by which it must turn; the rest is as for `turning_of`.
    """
    gaussians = apart(gaussians)
    assert gaussians.directional is not None
    index = gaussians.directional.index
    mean, deviation = turning_of(arrays, gaussians, views, shown)
    dropped = deviation < least * _LEAST_DEVIATION
    constant = gaussians.sh[0].index_add(1, index[dropped], mean[:, dropped] / SH_DC)
    kept = torch.zeros(len(gaussians), dtype=torch.bool).index_fill(0, index[~dropped], True)
    return replace(gaussians, sh=constant[None]).turning(kept)


def turning_as_nearest(new: Gaussians, known: Gaussians) -> Gaussians:
    """New Gaussians, of which those keep harmonics above the constant one whose nearest known one has any.

    Known ones whose centres are not finite count as none: they are about to be removed.
    """
    further = known.directional
    # Where all have them, as long as nobody has told, there is nothing to look up.
    if further is None or len(further) == len(known) or not len(new) or not new.degree:
        return new
    there = torch.nonzero(known.means.isfinite().all(dim=0))[:, 0]
    if not len(there):
        return new
    _, nearest = cKDTree(known.means[:, there].numpy().T).query(new.means.numpy().T)
    return new.turning(known.turns[there[torch.from_numpy(nearest)]])
