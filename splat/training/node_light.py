"""The light on nodes while they are trained: their own radiance is what they have in usual light."""

from __future__ import annotations

from dataclasses import replace

import torch

from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from splat.model.layer import Layer
from splat.model.light_course import factors_at, in_light, seen_from_behind
from splat.model.surface_light import Near, SurfaceLight

# Factor below which a pixel tells nothing of the radiance in usual light.
_LEAST = 0.1


class NodeLight:
    """The light that a layer's nodes have from points of surfaces.

    Args:
        light: at the points, in the coordinates of the nodes.

    Attributes:
        surface: as given.
    """

    def __init__(self, light: SurfaceLight):
        self.surface = light
        self._near = Near(torch.zeros(0, dtype=torch.int64), torch.zeros(0, dtype=torch.int64))

    def follow(self, layer: Layer) -> None:
        """Finds the points that are nearest to the nodes as they are now."""
        self._near = self.surface.near(layer.gaussians.means, layer.semantic)

    def lit(
        self, rest: Gaussians, shown: Gaussians, index: torch.Tensor, camera: Camera, time: float
    ) -> Gaussians:
        """Some nodes in the light that they have; torch can differentiate them.

        Args:
            rest, shown: M nodes, at rest and where they are.
            index: (M,) their indices in the layer.
            camera: which sees them.
            time: from 0 to 1.
        """
        near = self._near.select(index)
        changed = torch.nonzero(near.front >= 0)[:, 0]
        factor = self._factor(near.select(changed), rest.select(changed), shown.select(changed), camera, time)
        return in_light(shown, changed, factor)

    def in_usual_light(self, layer: Layer, shown: Gaussians, camera: Camera, time: float) -> Layer:
        """Nodes at rest that have the radiance seen by a camera, with that in usual light instead."""
        near = self.surface.near(layer.gaussians.means, layer.semantic)
        changed = torch.nonzero(near.front >= 0)[:, 0]
        own = layer.gaussians
        factor = self._factor(near.select(changed), own.select(changed), shown.select(changed), camera, time)
        return replace(layer, gaussians=in_light(own, changed, 1 / factor.clamp(min=_LEAST)))

    @torch.no_grad()
    def _factor(
        self, near: Near, rest: Gaussians, shown: Gaussians, camera: Camera, time: float
    ) -> torch.Tensor:
        """(3, M) factors of nodes whose light changes."""
        eye = torch.from_numpy(camera.position.copy()).float()
        normals = self.surface.normals[:, near.front]
        behind = seen_from_behind(normals, rest.rotations, shown.rotations, shown.means, eye)
        point = torch.where(behind, near.back, near.front)
        return factors_at(self.surface.factors, time)[:, point]

    def state(self) -> dict[str, torch.Tensor]:
        """Tensors for a checkpoint."""
        return {"light.front": self._near.front, "light.back": self._near.back}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restores what `state` returned; other tensors are ignored."""
        self._near = Near(tensors["light.front"], tensors["light.back"])
