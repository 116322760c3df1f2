"""A motion that nobody knows: a field, learned from frames."""

from __future__ import annotations

from collections.abc import Callable
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
        return Gaussians(**{**dict(gaussians.tensors()), **parts})

    def course(self, gaussians: Gaussians, instance: torch.Tensor) -> Callable[[float], Gaussians]:
        """As of `Dynamics`; a field knows nothing that all times share."""
        return partial(self.shown, gaussians, instance)

    def at_rest(self, gaussians: Gaussians, instance: torch.Tensor, time: float) -> Gaussians:
        """As of `Dynamics`; to first order, and as turned and as large as they are shown."""
        with torch.no_grad():
            moved = self.shown(gaussians, instance, time)
        return Gaussians(**{**dict(gaussians.tensors()), "means": 2 * gaussians.means - moved.means})

    def tensors(self) -> dict[str, torch.Tensor]:
        """All numbers, by name, which begins with that of the field."""
        state = self.field.state_dict()
        return {f"{self.kind.value}.{name}": tensor.detach() for name, tensor in state.items()}

    def __len__(self) -> int:
        return _ANY_NUMBER


def _field(kind: FieldKind, low: torch.Tensor, high: torch.Tensor) -> Field:
    return DeformationNetwork() if kind is FieldKind.D_GS else HexPlane(low, high)
