"""Draws views of a region at random, and chooses those to train on: each shows most of what is new.

Surfaces are divided into patches. Viewers, spread over the region, say how much each patch matters, and how
finely it must be shown: each of their pixels asks for its patch at its own resolution. A view answers those
that ask for no more than twice its own. The first view that answers a pixel is worth 1, each further one 0.4
times the one before. Such a sum is submodular: taking the best view at each turn comes within 1 - 1/e of the
best set (Nemhauser, Wolsey, Fisher 1978).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

# Up is an axis of the world if that of the camera leans by less than about 50 degrees from it.
_UPRIGHT = 0.65


@dataclass(frozen=True)
class Looks:
    """Views: positions (N, 3) in the world, and (N, 3, 3) camera-to-world rotations, OpenCV axes."""

    positions: Array
    rotations: Array

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, chosen: NDArray[np.generic] | slice) -> Looks:
        return Looks(self.positions[chosen], self.rotations[chosen])

    def camera(self, index: int, like: Camera) -> Camera:
        """One of the views as a camera with the intrinsics of another one."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotations[index], self.positions[index]
        return like.at(pose)

    def rays(self, like: Camera, side: int) -> tuple[Array, Array]:
        """Origins and directions, (N * side * side, 3) each, over a coarse grid of each frame."""
        x, y = np.meshgrid(*[(np.arange(side) + 0.5) / side] * 2)
        local = np.stack(
            [
                (x.ravel() * like.width - like.cx) / like.fx,
                (y.ravel() * like.height - like.cy) / like.fy,
                np.ones(side * side),
            ],
            axis=1,
        )
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        directions = np.einsum("nij,mj->nmi", self.rotations, local).reshape(-1, 3)
        return np.repeat(self.positions, side * side, axis=0), directions

    def probe(self, surfaces: Surfaces, like: Camera, side: int) -> Array:
        """(N, side * side) distances to what the views see; inf where there is nothing."""
        return surfaces.distance(*self.rays(like, side)).reshape(len(self), side * side)


def looks_of(cameras: list[Camera]) -> Looks:
    """Cameras as arrays, without their intrinsics."""
    poses = np.array([camera.camera_to_world for camera in cameras]).reshape(-1, 4, 4)
    return Looks(poses[:, :3, 3], poses[:, :3, :3])


def upright(home: Camera) -> Array:
    """(3,) what is up: the axis of the world that is nearest to the camera's own, else the camera's own."""
    own = -home.camera_to_world[:3, 1]
    axis = int(np.argmax(np.abs(own)))
    return np.sign(own[axis]) * np.eye(3)[axis] if abs(own[axis]) > _UPRIGHT else own


def turned_about(up: Array, yaw: Array, pitch: Array) -> Array:
    """(N, 3, 3) level camera-to-world rotations, of yaw (N,) about `up` (3,) and pitch (N,), degrees."""
    level = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    level /= np.linalg.norm(level)
    yaw, pitch = np.radians(yaw)[:, None], np.radians(pitch)[:, None]
    ahead = np.cos(yaw) * level + np.sin(yaw) * np.cross(up, level)
    forward = np.cos(pitch) * ahead + np.sin(pitch) * up
    right = np.cross(ahead, up)
    return np.stack([right, np.cross(forward, right), forward], axis=2)


def widened(camera: Camera, degrees: float) -> Camera:
    """The camera with a field of view of at least that many degrees along the frame's shorter side."""
    least = 0.5 / np.tan(np.radians(degrees) / 2)
    scale = min(1.0, least * min(camera.width, camera.height) / max(camera.fx, camera.fy))
    return replace(camera.at(camera.camera_to_world), fx=camera.fx * scale, fy=camera.fy * scale)


_Numbers = NDArray[np.int64]

# Side of the coarse frames that say what a view shows, in pixels.
_COARSE_SIDE = 12
# Largest share of a frame with surfaces that are too near, and smallest with any surface at all.
_NEAR_SHARE, _SEEN_SHARE = 0.1, 0.3
_TRIES = 24
# Streams of random numbers: validation views must not be among those that are trained on.
_TRAINING, _JUDGING, _VIEWING = 0, 1, 2
# Viewers, candidates for a round of views, and the views that a round gives.
_VIEWERS, _CANDIDATES, _ROUND = 768, 768, 192
# Side of the coarse frames in which patches are counted, in pixels.
_SIDE = 20
# What a further view of the same is worth.
_AGAIN = 0.4
# Levels per octave of resolution (frame heights per unit of length), and how many too low will do.
_PER_OCTAVE, _COARSER = 2.0, 2
_LOWEST, _LEVELS = -64, 128
# Cells along each axis that a key can tell apart; farther ones share theirs.
_CELLS = 1 << 16


class DrawnRegion(ABC):
    """A region whose views are drawn at random; training gets those that show most of what is new."""

    name: str
    _scene: Scene
    _surfaces: Surfaces
    # Side of a patch of surface, and distance of surfaces that are too near to look at.
    _patch: float
    _near: float
    # What error messages begin with, and say of all views, and if none shows anything.
    _source: str
    _views: str
    _nothing: str

    @abstractmethod
    def _propose(self, number: int, for_training: bool, rng: np.random.Generator) -> Looks:
        """Views that may show nothing; those to train on may look further aside than viewers."""

    def _first(self, home: Camera) -> Camera:
        """The first view to train on; `home` is the scene's own camera at the size of the frames."""
        return home

    def _trained(self, home: Camera) -> Camera:
        """A camera with the intrinsics of the other views to train on."""
        return home

    def views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to train on: a fixed one, then those that show most of what is new."""
        home = self._scene.camera.resized(width, height)
        first, like = self._first(home), self._trained(home)
        viewers = self._drawn(_VIEWERS, home, False, [0, _VIEWING, 0])
        selection = Selection(self._surfaces, self._patch, first.position, (viewers, home))
        draw = lambda number: self._drawn(_CANDIDATES, like, True, [seed, _TRAINING, number])  # noqa: E731
        return selection.chosen(count, first, like, draw)

    def unseen_views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Held-out validation views: what viewers may see anywhere in the region."""
        home = self._scene.camera.resized(width, height)
        looks = self._drawn(count, home, False, [seed, _JUDGING, 0])
        if len(looks) < count:
            raise UserError(f"{self._source}: only {len(looks)} of {count} views {self._views} show surfaces")
        return [looks.camera(index, home) for index in range(count)]

    def _drawn(self, count: int, like: Camera, for_training: bool, seeds: list[int]) -> Looks:
        """Up to `count` views that show something not too near; UserError if there are none."""
        rng, positions, rotations, total = np.random.default_rng(seeds), [], [], 0
        for _ in range(_TRIES):
            looks = self._propose(count, for_training, rng)
            distance = looks.probe(self._surfaces, like, _COARSE_SIDE)
            is_far = np.mean(distance < self._near, axis=1) <= _NEAR_SHARE
            looks = looks[is_far & (np.mean(np.isfinite(distance), axis=1) >= _SEEN_SHARE)]
            positions.append(looks.positions)
            rotations.append(looks.rotations)
            total += len(looks)
            if total >= count:
                break
        if not total:
            raise UserError(f"{self._source}: {self._nothing}")
        return Looks(np.concatenate(positions)[:count], np.concatenate(rotations)[:count])


class Selection:
    """Chooses views for viewers and their camera, by patches whose grid has an origin (3,)."""

    def __init__(self, surfaces: Surfaces, patch: float, origin: Array, viewers: tuple[Looks, Camera]):
        self._surfaces, self._patch, self._origin = surfaces, patch, origin
        patches, level, _ = self._pixels(*viewers)
        # Ordered by patch, then by level: what a view answers of a patch is a range.
        self._asked, pixels = np.unique(patches * _LEVELS + level, return_counts=True)
        self._weight = pixels / max(pixels.sum(), 1)

    def chosen(self, count: int, first: Camera, like: Camera, draw: Callable[[int], Looks]) -> list[Camera]:
        """Views, best first, the same whatever their number, after a `first` one.

        The others have the intrinsics of `like`, of candidates that `draw` gives for the number of the round.
        """
        views = [first][:count]
        lacking = self._weight.copy()
        lacking[self._answered(looks_of([first]), first)[0]] *= _AGAIN
        number = 0
        while len(views) < count:
            looks = draw(number)
            picks = min(_ROUND, len(looks), count - len(views))
            for index in self._best(self._answered(looks, like), len(looks), picks, lacking):
                views.append(looks.camera(index, like))
            number += 1
        return views

    def _best(self, answered: tuple[_Numbers, _Numbers], count: int, picks: int, lacking: Array) -> list[int]:
        """Indices of the best candidates in turn; takes what they answer from `lacking`."""
        asked, candidate = answered
        ends = np.searchsorted(candidate, np.arange(count + 1))
        is_left = np.ones(count, dtype=bool)
        found = []
        for _ in range(picks):
            gain = np.where(is_left, np.bincount(candidate, lacking[asked], minlength=count), -1.0)
            best = int(np.argmax(gain))
            found.append(best)
            is_left[best] = False
            lacking[asked[ends[best] : ends[best + 1]]] *= _AGAIN
        return found

    def _answered(self, looks: Looks, like: Camera) -> tuple[_Numbers, _Numbers]:
        """Index of what is asked for, and of the view, wherever a view answers it; ordered by views."""
        patches, level, view = self._pixels(looks, like)
        names, place = np.unique(patches, return_inverse=True)
        pairs, place = np.unique(view * len(names) + place, return_inverse=True)
        finest = np.zeros(len(pairs), dtype=np.int64)
        np.maximum.at(finest, place, level)
        patches, view = names[pairs % max(len(names), 1)], pairs // max(len(names), 1)
        start = np.searchsorted(self._asked, patches * _LEVELS)
        enough = np.minimum(finest + _COARSER, _LEVELS - 1)
        length = np.searchsorted(self._asked, patches * _LEVELS + enough, side="right") - start
        offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        return np.repeat(start, length) + offset, np.repeat(view, length)

    def _pixels(self, looks: Looks, like: Camera) -> tuple[_Numbers, _Numbers, _Numbers]:
        """Patch, level of resolution and view of each pixel that shows a surface."""
        origins, directions = looks.rays(like, _SIDE)
        distance, normal = self._surfaces.hits(origins, directions)
        seen = np.flatnonzero(np.isfinite(distance) & (distance > 0))
        distance, normal, directions = distance[seen], normal[seen], directions[seen]
        cells = np.floor((origins[seen] + directions * distance[:, None] - self._origin) / self._patch)
        cells = np.clip(cells, -_CELLS, _CELLS - 1).astype(np.int64) + _CELLS
        # Both sides of a wall lie in one cell, and so do the walls of a corner.
        axis = np.argmax(np.abs(normal), axis=1)
        side = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0)
        # Three times 17 bits, six sides and 128 levels are 61 bits.
        patch = ((cells[:, 0] * (2 * _CELLS) + cells[:, 1]) * (2 * _CELLS) + cells[:, 2]) * 6 + side
        cosine = np.maximum(-np.sum(normal * directions, axis=1), 1e-6)
        focal = np.sqrt(like.fx * like.fy) / like.height
        octaves = np.log2(focal * np.sqrt(cosine) * self._patch / distance)
        level = np.clip(np.round(_PER_OCTAVE * octaves) - _LOWEST, 0, _LEVELS - 1)
        return patch, level.astype(np.int64), seen // _SIDE**2
