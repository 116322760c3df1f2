"""Which nodes move, as the scene's surfaces tell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from compose.camera.coordinate_systems import WORLD, Place
from splat.model.gaussians import Gaussians
from splat.model.motion import NodeMotion
from splat.model.trees import static_layer
from tests.hybrid.measure.motion_truth import Triangles, nodes_that_move
from tests.moving import WAY, moving_corner


@dataclass
class Nodes:
    place: Place = WORLD
    motion: NodeMotion | None = None


def twin(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) distances to the nearest of many points on each triangle."""
    steps = np.linspace(0, 1, 101)
    u, v = (grid.ravel() for grid in np.meshgrid(steps, steps))
    u, v = u[u + v <= 1], v[u + v <= 1]
    a, b, c = corners[:, 0, None], corners[:, 1, None], corners[:, 2, None]
    samples = (a + u[None, :, None] * (b - a) + v[None, :, None] * (c - a)).reshape(-1, 3)
    return np.array([np.linalg.norm(samples - point, axis=1).min() for point in points])


def test_distances_to_triangles_equal_the_twins():
    rng = np.random.default_rng(3)
    corners, points = rng.random((6, 3, 3)), rng.uniform(-0.5, 1.5, (40, 3))
    found, expected = Triangles(corners).distance(points), twin(points, corners)
    assert (found <= expected + 1e-12).all()
    np.testing.assert_allclose(found, expected, atol=0.012)


def test_triangles_without_area_are_points_and_edges():
    corners = np.array([[[0, 0, 0]] * 3, [[2, 0, 0], [3, 0, 0], [2, 0, 0]]], dtype=np.float64)
    np.testing.assert_allclose(Triangles(corners).distance(np.array([[0, 1, 0], [2.5, 2, 0]])), [1, 2])


def test_of_no_points_there_are_no_distances():
    assert Triangles(np.zeros((1, 3, 3))).distance(np.zeros((0, 3))).shape == (0,)


@pytest.fixture(scope="module")
def corner(backend, tmp_path_factory):
    return moving_corner(tmp_path_factory.mktemp("moving"))


def test_what_goes_along_moves_and_so_does_what_is_left_where_something_passes(corner):
    """A node on the board, one on the floor, and one in mid-air where the board comes by."""
    corner.show(0.0)
    shape = next(iter(corner.moving.shapes))
    at_rest = np.asarray(shape.bbox().center(), dtype=np.float64).ravel()
    floor = at_rest.copy()
    floor[1] = -10.0
    means = np.stack([at_rest, at_rest, floor]).astype(np.float32)
    n = len(means)
    gaussians = Gaussians(
        torch.from_numpy(means.T.copy()),
        torch.full((3, n), -6.0),
        torch.tensor([[1.0], [0], [0], [0]]).repeat(1, n),
        torch.zeros(n),
        torch.zeros(1, 3, n),
    )
    moves = torch.tensor([True, False, False])
    layer = replace(static_layer(gaussians), semantic=torch.where(moves, 0, -1).int(), dynamic=moves)
    shifts = torch.tensor([[[0.0, 0, 0]], [[WAY, 0, 0]]], dtype=torch.float64)
    rotations = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(2, 1, 1)
    centres = torch.from_numpy(at_rest[None])
    motion = NodeMotion(rotations, centres, shifts, torch.ones(1, dtype=torch.int64))
    found, counts = nodes_that_move(corner, corner.moving, Nodes(motion=motion), layer, [0.0, 0.5, 1.0])
    assert counts.all()
    assert found.tolist() == [True, True, False]
