"""A motion that nobody knows: a field that deforms Gaussians, of D-GS or 4DGS, learned from frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn import functional

from splat.model.choices import FieldKind
from splat.model.gaussians import Gaussians


@dataclass(frozen=True)
class Deformation:
    """How N Gaussians differ from those at rest."""

    shifts: Tensor  # (3, N) of their means
    turns: Tensor  # (4, N) that are added to their unit quaternions
    growths: Tensor  # (3, N) that are added to their log scales

    def applied(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians, deformed.

        D-GS adds growths after the exponential, where they can make scales negative; here they are added
        before it.
        """
        turned = gaussians.rotations / gaussians.rotations.norm(dim=0, keepdim=True) + self.turns
        moved, grown = gaussians.means + self.shifts, gaussians.log_scales + self.growths
        return replace(gaussians, means=moved, rotations=turned, log_scales=grown)


class Heads(torch.nn.Module):
    """Turns features (N, width) of points into their deformation, at first none."""

    def __init__(self, width: int, hidden: bool):
        super().__init__()
        for name, size in (("shifts", 3), ("turns", 4), ("growths", 3)):
            last = torch.nn.Linear(width, size)
            torch.nn.init.zeros_(last.weight)
            torch.nn.init.zeros_(last.bias)
            before = [torch.nn.Linear(width, width), torch.nn.ReLU()] if hidden else []
            self.add_module(name, torch.nn.Sequential(*before, last))

    def forward(self, features: Tensor) -> Deformation:
        return Deformation(*(head(features).T for head in self.children()))


# Frequencies of the positional encoding: of places, and of times as for synthetic scenes.
_PLACES, _TIMES = 10, 6
_NETWORK_WIDTH, _DEPTH = 256, 8
# The encoding is joined to the features again after the layer of this index.
_JOINED = 4


class DeformationNetwork(torch.nn.Module):
    """A perceptron of eight layers that sees a place and a time."""

    # Learning rates at the start and at the end.
    RATES: ClassVar = {"": (8e-4, 1.6e-6)}

    def __init__(self) -> None:
        super().__init__()
        width = 3 * (1 + 2 * _PLACES) + 1 + 2 * _TIMES
        inputs = [width, *(_NETWORK_WIDTH + width * (index == _JOINED) for index in range(_DEPTH - 1))]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(size, _NETWORK_WIDTH) for size in inputs)
        self.heads = Heads(_NETWORK_WIDTH, hidden=False)

    def forward(self, means: Tensor, time: float) -> Deformation:
        """How Gaussians with means (3, N) are deformed at a time from 0 to 1."""
        times = means.new_full((means.shape[1], 1), time)
        encoded = torch.cat([_encoded(means.T, _PLACES), _encoded(times, _TIMES)], dim=1)
        features = encoded
        for index, layer in enumerate(self.layers):
            features = torch.relu(layer(features))
            if index == _JOINED:
                features = torch.cat([encoded, features], dim=1)
        return self.heads(features)


def _encoded(values: Tensor, frequencies: int) -> Tensor:
    """(N, C (1 + 2 F)) values (N, C), and sines and cosines of their multiples by 1, 2, 4, ..."""
    waves = [values]
    for power in range(frequencies):
        waves += [torch.sin(values * 2.0**power), torch.cos(values * 2.0**power)]
    return torch.cat(waves, dim=1)


# Features of a plane, and cells along an axis of space at each resolution, and along time.
_FEATURES, _SPACE, _TIME = 32, (64, 128), 25
_WIDTH = 64
# Pairs of the axes x, y, z, t.
_PAIRS = tuple(combinations(range(4), 2))


class HexPlane(torch.nn.Module):
    """Planes over each pair of the axes x, y, z and time, and a small perceptron.

    Places differ within a box with corners (3,). The regularizers (total variation of planes) are left out.
    """

    # Those of 4DGS are for 20,000 steps, a few times as many as are taken here, and as many times smaller.
    RATES: ClassVar = {"planes": (6.4e-3, 6.4e-4), "": (6.4e-4, 6.4e-5)}
    low: Tensor
    high: Tensor

    def __init__(self, low: Tensor, high: Tensor):
        super().__init__()
        self.register_buffer("low", low.float())
        self.register_buffer("high", high.float())
        self.planes = torch.nn.ParameterList()
        for space in _SPACE:
            for _, other in _PAIRS:
                # (1, F, cells of the second axis, of the first); over time, 1 at first as if nothing moved.
                shape = 1, _FEATURES, _TIME if other == 3 else space, space
                self.planes.append(torch.ones(shape) if other == 3 else torch.rand(shape) * 0.4 + 0.1)
        self.mix = torch.nn.Linear(_FEATURES * len(_SPACE), _WIDTH)
        self.heads = Heads(_WIDTH, hidden=True)

    def forward(self, means: Tensor, time: float) -> Deformation:
        size = (self.high - self.low).clamp(min=1e-6)
        places = 2 * (means.T - self.low) / size - 1
        at = torch.cat([places, means.new_full((means.shape[1], 1), 2 * time - 1)], dim=1)  # (N, 4)
        levels = []
        for level in range(len(_SPACE)):
            product = means.new_ones(means.shape[1], _FEATURES)
            for number, pair in enumerate(_PAIRS):
                plane, grid = self.planes[level * len(_PAIRS) + number], at[:, list(pair)][None, None]
                sampled = functional.grid_sample(plane, grid, align_corners=True, padding_mode="border")
                product = product * sampled[0, :, 0].T
            levels.append(product)
        return self.heads(torch.relu(self.mix(torch.cat(levels, dim=1))))


Field = DeformationNetwork | HexPlane
# Of instances, whose labels are 32-bit integers.
_ANY_NUMBER = 2**31 - 1


class LearnedMotion:
    """Deforms all nodes of any number of instances by a field in the coordinates of the nodes."""

    # Points (3, A) of instances (A,), at rest: what is shown comes to rest beside the nearest.
    anchors: tuple[Tensor, Tensor] | None = None

    def __init__(self, kind: FieldKind, field: Field):
        self.kind, self.field = kind, field

    @staticmethod
    def begun(kind: FieldKind, low: Tensor, high: Tensor, seed: int) -> LearnedMotion:
        """A motion before training, for nodes in a box with corners (3,)."""
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            field = DeformationNetwork() if kind is FieldKind.D_GS else HexPlane(low, high)
        return LearnedMotion(kind, field)

    @staticmethod
    def restored(tensors: dict[str, torch.Tensor]) -> LearnedMotion:
        """The motion whose `tensors` these are.

        KeyError, ValueError, RuntimeError if they are those of no field.
        """
        (kind,) = (FieldKind(name) for name in {name.split(".", 1)[0] for name in tensors})
        motion = LearnedMotion.begun(kind, torch.zeros(3), torch.ones(3), 0)
        motion.restore(tensors)
        motion.field.requires_grad_(False)
        return motion

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Becomes the motion of the same kind whose `tensors` these are."""
        self.field.load_state_dict({name.split(".", 1)[1]: tensor for name, tensor in tensors.items()})

    def shown(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        moving = torch.nonzero(instance >= 0)[:, 0]
        if len(moving) == len(gaussians):
            return self.field(gaussians.means, time).applied(gaussians)
        if not len(moving):
            return gaussians
        deformed = self.field(gaussians.means[:, moving], time).applied(gaussians.select(moving))
        parts = {name: getattr(deformed, name) for name in ("means", "rotations", "log_scales")}
        return gaussians.replaced(moving, **parts)

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        # A field knows nothing that all times share.
        return partial(self.shown, gaussians, instance)

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """The way back: as turned and as large as they are shown.

        Nodes are as far from rest as the nearest anchor of their instance; without anchors, as they would be
        if they were at rest where they are shown (first order).
        """
        with torch.no_grad():
            shifts = self.shown(gaussians, instance, time).means - gaussians.means
            if self.anchors is not None:
                points, of = self.anchors
                moved = self.field(points, time).shifts
                for number in torch.unique(of).tolist():
                    own, here = of == number, torch.nonzero(instance == number)[:, 0]
                    apart = torch.cdist(gaussians.means[:, here].T, (points + moved)[:, own].T)
                    shifts[:, here] = moved[:, own][:, apart.argmin(dim=1)]
        return replace(gaussians, means=gaussians.means - shifts)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name, which begins with that of the field."""
        state = self.field.state_dict()
        return {f"{self.kind.value}.{name}": tensor.detach() for name, tensor in state.items()}

    def __len__(self) -> int:
        return _ANY_NUMBER
