"""Which pixels show something that moves, and which object, from frames without masks.

Fov-GS (section 3.2) looks at the optical flow between a frame and a forest that stands still; but shadows
flow as well. Here, what a pixel shows is looked for, at the same place, in frames of other times:

1. Another frame looks through that place: what was there has gone. Sure wherever distances are, whether
   there is texture or not.
2. Another frame sees a surface at that place, of another texture: what was there has slid or turned in its
   own plane, or the distances do not know of it. Patches are compared by their normalised cross-correlation,
   on which a light that gets brighter or darker has no influence, and where they have no texture by their
   mean albedo, else their chromaticity.

What is hidden in another frame says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from torch.nn.functional import avg_pool2d

from compose.camera.camera import Camera
from splat.model.points import Bits, Floats, Ints

# Added to radiance before its logarithm is taken.
_DARK = 0.01


@dataclass(frozen=True)
class Observation:
    """One frame of something that may move."""

    camera: Camera
    radiance: NDArray[np.float32]  # (H, W, 3) float32, linear
    # (H, W) float32 along the ray to what is seen, known or rendered; inf where nothing is
    distance: NDArray[np.float32]
    time: float  # that the frame shows, from 0 to 1
    albedo: NDArray[np.float32] | None = None  # (H, W, 3) float32; None if it is not known

    @cached_property
    def appearance(self) -> NDArray[np.float32]:
        """(H, W, 3) what surfaces look like whatever the light: albedo, else the logarithm of radiance.

        A light that changes by a factor adds the same to that logarithm everywhere.
        """
        if self.albedo is not None:
            return self.albedo
        return np.log(np.maximum(self.radiance, 0) + _DARK).astype(np.float32)

    @property
    def known(self) -> Bits:
        """(H, W) whether anything is seen at a distance."""
        return np.isfinite(self.distance) & (self.distance > 0)

    @cached_property
    def inverse_depth(self) -> NDArray[np.float32]:
        """(H, W) one over the depth along the view axis, linear in the frame on a plane; 0 at infinity."""
        rays = self.camera.rays(self.camera.pixel_centres())
        cosine = (rays @ self.camera.world_to_camera[2, :3]).reshape(self.distance.shape)
        depth = np.where(self.known, self.distance, 1) * cosine
        return np.where(self.known, 1 / depth, 0).astype(np.float32)

    @cached_property
    def nearest(self) -> NDArray[np.float32]:
        """(H, W) nearest depth within a pixel of each; infinite where nothing is."""
        return _depths(-minimum_filter(-self.inverse_depth, 3))

    @cached_property
    def farthest(self) -> NDArray[np.float32]:
        """(H, W) farthest depth within a pixel of each; infinite where nothing is."""
        return _depths(minimum_filter(self.inverse_depth, 3))

    @cached_property
    def points(self) -> Floats:
        """(H, W, 3) world positions of what is seen; NaN where nothing is."""
        rays = self.camera.rays(self.camera.pixel_centres()).reshape(*self.distance.shape, 3)
        distance = np.where(self.known, self.distance.astype(np.float64), np.nan)
        return self.camera.position + rays * distance[..., None]


def _depths(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1), np.inf).astype(np.float32)


# Pixels that neighbours on one surface may lie apart, across it.
_STEP = 2.0
# Largest difference of appearance between neighbours on one surface.
_ALIKE = 0.08


def surfaces_of(points: Floats, appearance: NDArray[np.float32]) -> Ints:
    """(H, W) number of the surface that each pixel shows, from 0; -1 for none.

    Neighbouring pixels show the same surface if one lies in the plane of the other, or nearly, and they look
    nearly alike. Points (H, W, 3) are in world space, NaN where nothing is seen; appearance is (H, W, 3).
    """
    height, width = points.shape[:2]
    known = np.asarray(np.isfinite(points).all(axis=-1))
    normal, size = _planes(points)
    number = np.arange(height * width).reshape(height, width)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        way = points[b] - points[a]
        across = [np.abs((normal[side] * way).sum(axis=-1)) / size[side] for side in (a, b)]
        alike = np.abs(appearance[b] - appearance[a]).max(axis=-1) < _ALIKE
        joined = known[a] & known[b] & alike & (np.minimum(*across) < _STEP)
        links.append((number[a][joined], number[b][joined]))
    first, second = (np.concatenate(part) for part in zip(*links, strict=True))
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(number.size, number.size))
    _, found = connected_components(graph, directed=False)
    return np.where(known, found.reshape(height, width), -1).astype(np.int64)


def _planes(points: Floats) -> tuple[Floats, Floats]:
    """(H, W, 3) unit normals, of the flatter side of each pixel, and (H, W) sizes of pixels."""
    steps = []
    for axis in (0, 1):
        ahead = np.diff(points, axis=axis, append=np.nan)
        behind = np.diff(points, axis=axis, prepend=np.nan)
        lengths = [np.where(np.isnan(s[..., 0]), np.inf, (s**2).sum(axis=-1)) for s in (ahead, behind)]
        steps.append(np.where((lengths[0] <= lengths[1])[..., None], ahead, behind))
    normal = np.cross(steps[0], steps[1])
    length = np.linalg.norm(normal, axis=-1)
    size = np.minimum(*(np.linalg.norm(step, axis=-1) for step in steps))
    unit = normal / np.where(length > 0, length, 1)[..., None]
    return np.nan_to_num(unit), np.nan_to_num(size, nan=np.inf) + 1e-12


# Relative difference of depths that counts as none.
_TOLERANCE = 0.005
# Share of the frames that could show what a pixel shows, from which on it has moved if they look through it.
_GONE = 0.1
# Share of the frames that show a surface there, from which on it has moved if they show another one.
_CHANGED = 1 / 3
# Frames that must have shown a surface there for that share to mean something.
_LEAST_COMPARED = 2
# Frames at most that each is looked for in, and nearest ones whose patches it is compared with.
_MOST_FRAMES, _COMPARED = 32, 10
# Degrees between the rays along which two frames see a point: of a ball of rough metal 0.1 % of patches look
# different up to here, 18 % up to twice as far.
_SAME_VIEW = 3.0
# Side in pixels of patches, and the least deviation within one that is texture.
_PATCH, _TEXTURE = 5, 0.09
# Correlation below which patches show different things, and difference of their mean colours above which.
_CORRELATED, _COLOUR = 0.5, 0.3
# Share of a surface that must be seen to move for all of it to move.
_MOST_OF_IT = 0.3
_Votes = NDArray[np.int32]


def moving_pixels(observations: Sequence[Observation]) -> list[Bits]:
    """(H, W) for each frame of a scene, which pixels show something that moves: nothing at a single time."""
    found = []
    for index, frame in enumerate(observations):
        gone, there, changed, compared = _votes(observations, index)
        has_changed = (changed > _CHANGED * compared) & (compared >= _LEAST_COMPARED)
        # Without lone pixels, and over the whole of surfaces most of which moves.
        moves = median_filter((gone > _GONE * (gone + there)) | has_changed, 3)
        if moves.any():
            surface = surfaces_of(frame.points, frame.appearance)
            known = surface >= 0
            pixels = np.maximum(np.bincount(surface[known]), 1)
            share = np.bincount(surface[known], weights=moves[known]) / pixels
            moves |= known & (share >= _MOST_OF_IT)[surface]
        found.append(moves)
    return found


def _votes(frames: Sequence[Observation], index: int) -> list[_Votes]:
    """How frames of other times agree with a frame: four numbers of frames, (H, W) each.

    Those that look through what a pixel shows, those that see a surface at its place; of the nearest views
    those that see another surface there, and those that could tell.
    """
    frame = frames[index]
    others = [other for other in frames if other.time != frame.time]
    shape = frame.distance.shape
    gone, there, changed, compared = (np.zeros(shape, dtype=np.int32) for _ in range(4))
    # Evenly spread over their times.
    ordered = sorted(others, key=lambda other: other.time)
    for number in np.linspace(0, len(ordered) - 1, min(len(ordered), _MOST_FRAMES)).round().astype(int):
        _look_through(frame, ordered[number], gone, there)
    way = lambda other: np.linalg.norm(frame.camera.position - other.camera.position)  # noqa: E731
    for other in sorted(others, key=way)[:_COMPARED]:
        _compare(frame, other, changed, compared)
    return [gone, there, changed, compared]


def _look_through(frame: Observation, other: Observation, gone: _Votes, there: _Votes) -> None:
    pixels, position, depth = _projected(frame, other)
    column, row = position.astype(np.int64).T
    # What lies in front of all that the nine pixels around a place show, cannot be among them.
    nearest, farthest = other.nearest[row, column], other.farthest[row, column]
    is_gone = nearest > depth * (1 + _TOLERANCE)
    is_there = ~is_gone & (farthest >= depth * (1 - _TOLERANCE))
    gone.ravel()[pixels[is_gone]] += 1
    there.ravel()[pixels[is_there]] += 1


def _projected(frame: Observation, other: Observation) -> tuple[Ints, Floats, Floats]:
    """Row-major indices (M,) of those points that lie within another frame, at least a pixel from its border.

    And their positions (M, 2) in it and depths (M,).
    """
    pixels = np.flatnonzero(frame.inverse_depth > 0)
    position, depth = other.camera.project(frame.points.reshape(-1, 3)[pixels])
    size = np.array([other.camera.width, other.camera.height])
    inside = (depth > 0) & ((position >= 1) & (position < size - 1)).all(axis=1)
    return pixels[inside], position[inside], depth[inside]


def _compare(frame: Observation, other: Observation, changed: _Votes, compared: _Votes) -> None:
    """Adds the vote of a near view on whether patches at the same place look alike."""
    found = _projected(frame, other)
    points = frame.points.reshape(-1, 3)[found[0]]
    rays = [points - one.camera.position for one in (frame, other)]
    lengths = [np.linalg.norm(ray, axis=1) for ray in rays]
    cosine = (rays[0] * rays[1]).sum(axis=1) / (lengths[0] * np.maximum(lengths[1], 1e-12))
    pixels, position, depth = (part[cosine > np.cos(np.radians(_SAME_VIEW))] for part in found)
    shape = frame.distance.shape
    corner = (position - 0.5).astype(np.int64)
    (left, top), (x, y) = corner.T, (position - 0.5 - corner).T.astype(np.float32)
    corners = (top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)
    weights = (1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y
    around = list(zip(weights, corners, strict=True))
    inverse = sum(weight * other.inverse_depth[at] for weight, at in around)
    seen = np.zeros(shape, dtype=np.float32)
    seen.ravel()[pixels] = np.abs(inverse * depth - 1) < _TOLERANCE
    warped = np.zeros((*shape, 3), dtype=np.float32)
    warped.reshape(-1, 3)[pixels] = sum(weight[:, None] * other.appearance[at] for weight, at in around)
    is_albedo = frame.albedo is not None and other.albedo is not None
    tells, differs = _difference(frame.appearance, warped, seen, is_albedo)
    compared += tells
    changed += differs


def _difference(
    a: NDArray[np.float32], b: NDArray[np.float32], seen: NDArray[np.float32], is_albedo: bool
) -> tuple[Bits, Bits]:
    """(H, W) where patches of two images (H, W, 3) tell whether they are alike, and where they are not.

    `seen` (H, W) is 1 where both show a surface at the same place, else 0. Of albedo, a change of brightness
    is one of the surface.
    """
    squares = [(image * other).sum(axis=-1) for image, other in ((a, a), (b, b), (a, b))]
    channels = (*np.moveaxis(a, -1, 0), *np.moveaxis(b, -1, 0))
    # Weighted means over patches; of the first, the mean weight.
    stacked = torch.from_numpy(np.stack([np.ones_like(seen), *channels, *squares]) * seen)
    weight, *sums = avg_pool2d(stacked[None], _PATCH, stride=1, padding=_PATCH // 2)[0].numpy()
    means = [total / np.maximum(weight, 1e-6) for total in sums]
    mean_a, mean_b = np.stack(means[:3], axis=-1), np.stack(means[3:6], axis=-1)
    variance_a = np.maximum(means[6] - (mean_a**2).sum(axis=-1), 0)
    variance_b = np.maximum(means[7] - (mean_b**2).sum(axis=-1), 0)
    covariance = means[8] - (mean_a * mean_b).sum(axis=-1)
    usable = (seen > 0) & (weight > 0.5)
    textured = np.minimum(variance_a, variance_b) > _TEXTURE**2
    uncorrelated = covariance < _CORRELATED * np.sqrt(variance_a * variance_b)
    offset = mean_a - mean_b
    if not is_albedo:
        offset -= offset.mean(axis=-1, keepdims=True)
    other_colour = np.abs(offset).max(axis=-1) > _COLOUR
    return usable, usable & (other_colour | (textured & uncorrelated))


# Points of what moves, about, from which objects are made.
_POINTS = 8000
# Distance up to which two points at the same time are of one object, in units of the median distance of what
# moves; a step from one frame to the next, in the order of their times, counts as half of that.
_NEAR = 0.06
# Share of all moving points from which on they are an object of their own; fewer belong to the nearest one.
_LEAST = 0.02


def objects_of(observations: Sequence[Observation], moving: Sequence[Bits]) -> list[NDArray[np.int32]]:
    """(H, W) for each frame, which object a pixel shows, from 0; -1 for what stands still.

    Points are of one object if they are near each other in space and in time, or if others lead from one to
    the other. Objects that touch are one. They are numbered by how much of them is seen, most first.
    `moving` tells for each frame which pixels (H, W) show something that moves.
    """
    shown = [mask & one.known for one, mask in zip(observations, moving, strict=True)]
    clouds = _clouds(observations, shown)
    every = max(1, sum(map(len, clouds)) // _POINTS)
    sampled = np.concatenate([cloud[::every] for cloud in clouds]) if clouds else np.zeros((0, 4))
    if not len(sampled):
        return [np.full(mask.shape, -1, dtype=np.int32) for mask in moving]
    number = _numbers(sampled)
    tree = cKDTree(sampled)
    found = []
    for cloud, mask in zip(clouds, shown, strict=True):
        labels = np.full(mask.shape, -1, dtype=np.int32)
        labels[mask] = number[tree.query(cloud)[1]] if len(cloud) else 0
        found.append(labels)
    return found


def _clouds(observations: Sequence[Observation], shown: Sequence[Bits]) -> list[Floats]:
    """For each frame (M, 4) the points of what moves, and when, in units of how far apart points may be."""
    distances = [one.distance[mask] for one, mask in zip(observations, shown, strict=True)]
    near = _NEAR * float(np.median(np.concatenate(distances))) if sum(map(len, distances)) else 1.0
    times = sorted({one.time for one in observations})
    order = {time: 0.5 * step for step, time in enumerate(times)}
    return [
        np.concatenate([one.points[mask] / near, np.full((int(mask.sum()), 1), order[one.time])], axis=1)
        for one, mask in zip(observations, shown, strict=True)
    ]


def _numbers(points: Floats) -> NDArray[np.int32]:
    """(N,) object of each point (N, 4), by links of length 1 at most."""
    pairs = cKDTree(points).query_pairs(1.0, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, part = connected_components(links, directed=False)
    size = np.bincount(part)
    large = np.flatnonzero(size >= max(_LEAST * len(points), 1))
    large = large[np.argsort(-size[large], kind="stable")] if len(large) else np.array([size.argmax()])
    rank = np.full(len(size), -1, dtype=np.int32)
    rank[large] = np.arange(len(large))
    number = rank[part]
    rest = number < 0
    if rest.any():
        nearest = cKDTree(points[~rest]).query(points[rest])[1]
        number[rest] = number[~rest][nearest]
    return number
