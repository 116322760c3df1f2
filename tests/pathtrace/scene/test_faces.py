"""Points on the faces of a mesh."""

from __future__ import annotations

import numpy as np

from pathtrace.scene.courses import spread_over_faces

VERTICES = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [3, 1, 0], [9, 9, 9]], dtype=float)
FACES = np.array([[0, 1, 2], [2, 1, 3], [4, 4, 4]])


def test_points_are_evenly_spread_over_what_has_an_area():
    corners, shares = spread_over_faces(VERTICES, FACES, 20_000)
    points = np.einsum("nc,nci->ni", shares, VERTICES[corners])
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-12)
    assert (shares >= 0).all()
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=(3, 2), range=((0, 3), (0, 1)))
    np.testing.assert_allclose(counts, 20_000 / 6, rtol=0.06)


def test_there_are_none_where_nothing_has_an_area():
    corners, shares = spread_over_faces(VERTICES, FACES[2:], 10)
    assert (corners.shape, shares.shape) == ((0, 3), (0, 3))
