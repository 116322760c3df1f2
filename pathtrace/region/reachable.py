"""All of the space that a viewer can reach from the scene's own camera, looking anywhere.

The free space is a lattice that is flooded by straight steps. A viewer is a ball. It stands at a node of the
lattice if no surface is nearer than its radius, and steps to a neighbour if a tube of that radius joins the
two, so that it does not leave a room through a gap that is narrower than it is. Scenes end where their
geometry does; where there is sky, the space ends as well.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera, sphere_directions, unit
from pathtrace.region.view_selection import DrawnRegion, Looks, turned_about, upright, widened
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

Mask = NDArray[np.bool_]
_Nodes = NDArray[np.int64]

# Lengths in units of the lower quartile of the distances to surfaces from the space that the camera sees:
# a room of 4 by 4 by 2.5 metres has one of about a metre.
_SPACING = 0.22
_RADIUS = 0.1
# Besides the lattice's nodes, the space around the camera itself counts, up to so far from its surfaces.
_MARGIN = 0.25
# In units of the distance to what lies farthest from the camera (95 %): where the space ends, and where
# whatever is farther away does not enclose a place.
_REACH, _ENCLOSING = 1.25, 2.0
# Where more of all directions than this lead to no surface, a place is outside for a viewer who starts in a
# room: a window shows less sky from most of a room. The other says when a viewer starts outside.
_OUTSIDE, _IN_THE_OPEN = 0.12, 0.35
# Nodes at most: the nearest of them, in steps.
_MOST_NODES = 24_000
_DIRECTIONS = 96
# Of points that are not nodes; less than that of nodes, between which they lie.
_POINT_DIRECTIONS = 48
_POINT_RADIUS = 0.5
_TUBE = 8
# Nodes to which the camera may step at first: up to so many along each axis.
_FIRST_STEPS = 2
_STEPS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)), dtype=np.int64)
# Nodes along each axis to either side that a key can tell apart.
_HALF = 1 << 20
# Steepest looks in degrees: of viewers, and of views to train on, which may show floor and ceiling as well.
_PITCH, _TRAINING_PITCH = 30.0, 45.0
# Least field of view of the views to train on, in degrees. Wider views than those of viewers show a little
# more, and all of it coarser: 100 views of 36, 60 and 75 degrees cover 74, 69 and 68 % of what viewers with
# 36 degrees see at half of their resolution.
_FIELD_OF_VIEW = 40.0
# Surfaces nearer than this many radii of a viewer are too near to look at.
_NEAR = 2.0
# Side of a patch of surface whose views are counted, in units of the space's size.
_PATCH = 0.12


class Measures:
    """Sizes of the space around a scene's camera, in the scene's unit; UserError if it sees no surface."""

    def __init__(self, scene: Scene, surfaces: Surfaces):
        home, small = scene.camera, scene.camera.resized(12, 12)
        rays = small.rays(small.pixel_centres())
        depth = surfaces.around(home.position[None], rays)[0]
        rays, depth = rays[np.isfinite(depth)], depth[np.isfinite(depth)]
        if not len(depth):
            raise UserError(f"{scene.name}: the scene's own camera sees no surface")
        directions = sphere_directions(_DIRECTIONS)
        places = [home.position + rays * (share * depth)[:, None] for share in (0.25, 0.5, 0.75)]
        around = surfaces.around(np.concatenate(places), directions)
        # Lower quartile of the distances to surfaces from places that the camera sees.
        self.size = float(np.quantile(around[np.isfinite(around)], 0.25))
        self.seen = float(np.median(depth))
        whole = surfaces.around(home.position[None], sphere_directions(_DIRECTIONS * 4))
        farthest = float(np.quantile(np.append(whole[np.isfinite(whole)], depth), 0.95))
        # How far the space reaches, and the distance of the farthest surfaces that enclose a place.
        self.reach, self.enclosing = _REACH * farthest, _ENCLOSING * farthest
        self.is_open = bool(np.mean(whole > self.enclosing) > _IN_THE_OPEN)
        # Corners (3,) of the box in which the space lies.
        margin = _MARGIN * self.size
        low, high = surfaces.bounds
        self.low = np.minimum(low, home.position - margin)
        self.high = np.maximum(high, home.position + margin)


class FreeSpace:
    """The space that can be reached from a scene's own camera; UserError as for its `measures`.

    Nodes (N, 3) are centres of those of a lattice's cells that can be reached; the camera's own is not among
    them if surfaces are too near. The spacing is the lattice's, the radius the viewer's.
    """

    def __init__(self, scene: Scene, surfaces: Surfaces):
        self._surfaces, self._home = surfaces, scene.camera.position
        self.measures = Measures(scene, surfaces)
        self.spacing, self.radius = _SPACING * self.measures.size, _RADIUS * self.measures.size
        self._home_clearance = surfaces.clearance(self._home)
        self._directions = sphere_directions(_DIRECTIONS)
        reached = self._flooded()
        self._reached = np.sort(_key(reached))
        self.nodes = self._position(reached)

    def contains(self, points: Array) -> Mask:
        """(N,) whether a viewer can be at points (N, 3): not too near to surfaces, and joined to a node."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        found = np.zeros(len(points), dtype=bool)
        # False for what is not a number.
        inside = np.abs(points - self._home).max(axis=1) < _HALF / 2 * self.spacing
        index = np.flatnonzero(inside)
        local = (points[index] - self._home) / self.spacing
        is_near = np.linalg.norm(local, axis=1) <= 1
        corners = np.floor(local).astype(np.int64)[:, None] + _CORNERS
        usable = np.isin(_key(corners.reshape(-1, 3)), self._reached).reshape(-1, len(_CORNERS))
        kept = usable.any(axis=1) | is_near
        index, is_near, corners, usable = index[kept], is_near[kept], corners[kept], usable[kept]
        clearance = self._surfaces.clearances(points[index], _POINT_DIRECTIONS)
        least = np.full(len(index), _POINT_RADIUS * self.radius)
        # Around the camera itself, which may stand nearer to a wall than others.
        least[is_near] = min(_POINT_RADIUS * self.radius, 0.5 * self._home_clearance)
        joined = is_near & self._surfaces.are_joined(np.tile(self._home, (len(index), 1)), points[index])
        row, column = np.nonzero(usable)
        nodes = self._position(corners[row, column])
        np.logical_or.at(joined, row, self._surfaces.are_joined(nodes, points[index][row]))
        found[index] = joined & (clearance >= least)
        return found

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """(count, 3) points, uniformly in the space."""
        cells = self.nodes[rng.integers(len(self.nodes), size=4 * count)]
        points = cells + (rng.random((4 * count, 3)) - 0.5) * self.spacing
        kept = points[self.contains(points)][:count]
        # Nodes themselves are free: where hardly anything beside them is, as in a narrow passage.
        return np.concatenate([kept, cells[: count - len(kept)]])

    def _flooded(self) -> _Nodes:
        """(N, 3) nodes that can be reached, in the order of steps."""
        axis = range(-_FIRST_STEPS, _FIRST_STEPS + 1)
        front = np.array(list(itertools.product(axis, repeat=3)), dtype=np.int64)
        for is_good in (self._is_within, self._is_free):
            front = front[is_good(front)]
        ends, homes = self._position(front), np.tile(self._home, (len(front), 1))
        # No wider than the place where the camera stands.
        front = front[self._are_passable(homes, ends, min(self.radius, 0.5 * self._home_clearance))]
        known = np.zeros(0, dtype=np.int64)
        reached, total = [front], len(front)
        while len(front):
            known = np.union1d(known, _key(front))
            start = np.repeat(front, len(_STEPS), axis=0)
            end = start + np.tile(_STEPS, (len(front), 1))
            new = ~np.isin(_key(end), known) & self._is_within(end)
            start, end = start[new], end[new]
            nodes, place = np.unique(end, axis=0, return_inverse=True)
            is_free = self._is_free(nodes)
            known = np.union1d(known, _key(nodes[~is_free]))
            kept = is_free[place.ravel()]
            start, end = start[kept], end[kept]
            end = end[self._are_passable(self._position(start), self._position(end), self.radius)]
            front = np.unique(end, axis=0)
            if total + len(front) > _MOST_NODES:
                break
            reached.append(front)
            total += len(front)
        return np.concatenate(reached)

    def _is_within(self, nodes: _Nodes) -> Mask:
        points, limit = self._position(nodes), self.measures
        is_near = np.linalg.norm(points - self._home, axis=1) <= limit.reach
        return is_near & (points >= limit.low).all(axis=1) & (points <= limit.high).all(axis=1)

    def _is_free(self, nodes: _Nodes) -> Mask:
        """Whether nodes are not too near to surfaces, and not where the scene does not go on."""
        points, limit = self._position(nodes), self.measures
        around = self._surfaces.around(points, self._directions)
        is_open = np.mean(around > limit.enclosing, axis=1) > _OUTSIDE
        is_near = np.linalg.norm(points - self._home, axis=1) <= limit.seen
        # A viewer in a room does not climb out of its window; one in the open stays near what it looks at.
        is_inside = ~is_open | (is_near & limit.is_open)
        return (around.min(axis=1, initial=np.inf) >= self.radius) & is_inside

    def _are_passable(self, starts: Array, ends: Array, radius: float) -> Mask:
        """Whether tubes between points (N, 3) and (N, 3) hold no surface."""
        ways = ends - starts
        # Any two axes across; the step from the camera to where it stands has none.
        is_along_x = np.abs(unit(ways)[:, :1]) > 0.6
        aside = np.cross(ways, np.where(is_along_x, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
        above = np.cross(ways, aside)
        passable = self._surfaces.are_joined(starts, ends)
        for turn in np.arange(_TUBE) * 2 * np.pi / _TUBE:
            shift = radius * (np.cos(turn) * unit(aside) + np.sin(turn) * unit(above))
            passable[passable] = self._surfaces.are_joined(
                starts[passable] + shift[passable], ends[passable] + shift[passable]
            )
        return passable

    def _position(self, nodes: _Nodes) -> Array:
        return self._home + nodes * self.spacing


def _key(nodes: _Nodes) -> _Nodes:
    shifted = nodes + _HALF
    return (shifted[:, 0] * (2 * _HALF) + shifted[:, 1]) * (2 * _HALF) + shifted[:, 2]


class ReachableRegion(DrawnRegion):
    """The reachable space of a scene, as a lattice; UserError if its camera sees nothing, or has no space."""

    name = "reachable"
    _views = "of it"
    _nothing = "nothing can be seen from the space around the scene's own camera"

    def __init__(self, scene: Scene, surfaces: Surfaces):
        self._scene, self._surfaces, self._source = scene, surfaces, scene.name
        self.space = FreeSpace(scene, surfaces)
        self._patch, self._near = _PATCH * self.space.measures.size, _NEAR * self.space.radius
        if not len(self.space.nodes):
            unit = scene.place.unit
            raise UserError(
                f"{scene.name}: no free space around the scene's own camera for a viewer with a radius of "
                f"{self.space.radius * unit:.3g}; the nearest surface is "
                f"{surfaces.clearance(scene.camera.position) * unit:.3g} away"
            )
        self._up = upright(scene.camera)

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether a viewer can be at points (N, 3)."""
        return self.space.contains(points)

    def identity(self) -> dict[str, Any]:
        """What tells it from other regions of the same scene."""
        return {"kind": "reachable"}

    def _trained(self, home: Camera) -> Camera:
        return widened(home, _FIELD_OF_VIEW)

    def _propose(self, number: int, for_training: bool, rng: np.random.Generator) -> Looks:
        positions = self.space.sample(number, rng)
        steepest = _TRAINING_PITCH if for_training else _PITCH
        yaw, pitch = 360 * rng.random(number), steepest * (2 * rng.random(number) - 1)
        return Looks(positions, turned_about(self._up, yaw, pitch))
