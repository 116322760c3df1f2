"""What changes over time in one layer of a forest: where its nodes are, and how bright.

Only layers that are drawn are brought to a time (Fov-GS, section 3.4: selection comes before deformation).
"""

from __future__ import annotations

import torch

from compose.camera.camera import Camera
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.model.light_course import LightCourse, in_light, seen_from_behind


class LayerChanges:
    """The changes of the nodes of a layer; each is given out once per time.

    Args:
        forest: at rest.
        first, end: of the layer's nodes in the forest.

    Attributes:
        moves: whether any of the nodes does.
    """

    def __init__(self, forest: Forest, first: int, end: int):
        self._own = forest.nodes.gaussians
        self._dynamic, self._course = torch.zeros(0, dtype=torch.int64), None
        if forest.motion is not None:
            labels = forest.nodes.semantic[first:end]
            self._dynamic = first + torch.nonzero(labels >= 0)[:, 0]
        if forest.motion is not None and len(self._dynamic):
            instance = forest.nodes.semantic[self._dynamic]
            self._course = forest.motion.course(self._own.select(self._dynamic), instance)
        self._light = None if forest.light is None else forest.light.among(first, end)
        # Those whose light changes, in usual light.
        lit = torch.zeros(0, dtype=torch.int64) if self._light is None else self._light.nodes
        self._usual = self._own.select(lit)
        self._means, self._rotations = self._own.means, self._own.rotations
        self._moved_to, self._lit_at, self._eye = -1.0, -1.0, b""

    @property
    def moves(self) -> bool:
        return self._course is not None

    def moved(self, time: float) -> tuple[torch.Tensor, Gaussians] | None:
        """Indices (M,) of nodes in the forest and where they are at a time; None if given out already."""
        if self._course is None or self._moved_to == time:
            return None
        self._moved_to = time
        with torch.no_grad():
            found = self._course(time)
        if self._light is not None and len(self._light.sided):
            self._means = self._own.means.index_copy(1, self._dynamic, found.means)
            self._rotations = self._own.rotations.index_copy(1, self._dynamic, found.rotations)
        return self._dynamic, found

    def lit(self, time: float, camera: Camera) -> tuple[torch.Tensor, Gaussians] | None:
        """Indices (M,) of nodes, and Gaussians (M) with harmonics in the light of a time; None if given out.

        Args:
            time: at which the nodes are already.
            camera: which sees them, in their coordinates; it matters to nodes with two sides.
        """
        light = self._light
        if light is None or not len(light.nodes):
            return None
        eye = camera.position.tobytes() if len(light.sided) else b""
        if (self._lit_at, self._eye) == (time, eye):
            return None
        nodes, factors, shown = light.nodes, light.at(time), self._usual
        if len(light.sided):
            behind = self._seen_from_behind(light, camera)
            factors[:, light.sided] = torch.where(behind, light.behind_at(time), factors[:, light.sided])
        if self._lit_at == time:
            # Another eye may see another side; all else is as it was.
            nodes, factors = nodes[light.sided], factors[:, light.sided]
            shown = shown.select(light.sided)
        self._lit_at, self._eye = time, eye
        return nodes, in_light(shown, torch.arange(len(nodes)), factors)

    def _seen_from_behind(self, light: LightCourse, camera: Camera) -> torch.Tensor:
        """(B,) whether nodes with two sides are seen from behind where they are now."""
        nodes = light.nodes[light.sided]
        rest, now, means = (part[:, nodes] for part in (self._own.rotations, self._rotations, self._means))
        eye = torch.from_numpy(camera.position.copy()).float()
        return seen_from_behind(light.normals, rest, now, means, eye)
