"""A motion that nobody knows: a field, learned from frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch

from splat.deformation.hexplane import HexPlane
from splat.deformation.network import DeformationNetwork
from splat.model.gaussians import Gaussians
from splat.model.motion_model import FieldKind

Field = DeformationNetwork | HexPlane
# Of instances, whose labels are 32-bit integers.
_ANY_NUMBER = 2**31 - 1


class LearnedMotion:
    """Deforms all nodes that belong to an instance, of which there may be any number.

    Args:
        kind: of the field.
        field: the field itself, in the coordinates of the nodes.
    """

    def __init__(self, kind: FieldKind, field: Field):
        self.kind, self.field = kind, field
        self._anchors: tuple[torch.Tensor, torch.Tensor] | None = None

    def anchor(self, points: torch.Tensor, instance: torch.Tensor) -> None:
        """Tells points (3, A) of instances (A,), at rest: what is shown comes to rest beside the nearest."""
        self._anchors = points, instance

    @staticmethod
    def begun(kind: FieldKind, low: torch.Tensor, high: torch.Tensor, seed: int) -> LearnedMotion:
        """A motion before training, for nodes in a box with corners (3,)."""
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            return LearnedMotion(kind, _field(kind, low, high))

    @staticmethod
    def restored(tensors: dict[str, torch.Tensor]) -> LearnedMotion:
        """The motion whose `tensors` these are.

        Raises:
            KeyError, ValueError, RuntimeError: they are those of no field.
        """
        (kind,) = (FieldKind(name) for name in {name.split(".", 1)[0] for name in tensors})
        motion = LearnedMotion(kind, _field(kind, torch.zeros(3), torch.ones(3)))
        motion.restore(tensors)
        motion.field.requires_grad_(False)
        return motion

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Becomes the motion of the same kind whose `tensors` these are."""
        self.field.load_state_dict({name.split(".", 1)[1]: tensor for name, tensor in tensors.items()})

    def shown(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """As of `Dynamics`."""
        moving = torch.nonzero(instance >= 0)[:, 0]
        if len(moving) == len(gaussians):
            return self.field(gaussians.means, time).applied(gaussians)
        if not len(moving):
            return gaussians
        deformed = self.field(gaussians.means[:, moving], time).applied(gaussians.select(moving))
        names = "means", "rotations", "log_scales"
        parts = {
            name: getattr(gaussians, name).index_copy(1, moving, getattr(deformed, name)) for name in names
        }
        return replace(gaussians, **parts)

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        """As of `Dynamics`; a field knows nothing that all times share."""
        return partial(self.shown, gaussians, instance)

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """As of `Dynamics`; as turned and as large as they are shown.

        Nodes are as far from rest as the nearest anchor of their instance; without anchors, as they would be
        if they were at rest where they are shown (first order).
        """
        with torch.no_grad():
            shifts = self.shown(gaussians, instance, time).means - gaussians.means
            if self._anchors is not None:
                points, of = self._anchors
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


def _field(kind: FieldKind, low: torch.Tensor, high: torch.Tensor) -> Field:
    return DeformationNetwork() if kind is FieldKind.D_GS else HexPlane(low, high)
