"""Triangles of shapes: their area and place are those of the shapes themselves."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.scene.triangles import triangles_of

pytestmark = pytest.mark.usefixtures("backend")


def triangles(shape: dict, scale: float = 2.0) -> np.ndarray:
    """(M, 3, 3) of a shape that is scaled, then moved by (1, 2, 3), moved back."""
    to_world = mi.ScalarTransform4f().translate([1, 2, 3]).scale(scale)
    found = triangles_of(mi.load_dict({**shape, "to_world": to_world}))
    assert found is not None
    return found - [1, 2, 3]


def area(corners: np.ndarray) -> float:
    sides = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2)


@pytest.mark.parametrize(
    ("kind", "expected", "tolerance"),
    [
        ("rectangle", 16, 1e-6),
        ("cube", 96, 1e-6),
        # Inscribed: a little less than the round ones; worst seen 0.8 %.
        ("disk", 4 * np.pi, 0.01),
        ("cylinder", 8 * np.pi, 0.01),
        ("sphere", 16 * np.pi, 0.01),
    ],
)
def test_the_area_is_the_shapes(kind, expected, tolerance):
    found = area(triangles({"type": kind}))
    assert found == pytest.approx(expected, rel=tolerance)
    assert found <= expected * (1 + 1e-5)


def test_corners_lie_on_the_shapes():
    rectangle, disk, cylinder, sphere = (
        triangles({"type": kind}).reshape(-1, 3) for kind in ("rectangle", "disk", "cylinder", "sphere")
    )
    assert {tuple(corner) for corner in rectangle.round(5)} == {
        (x, y, 0.0) for x in (-2.0, 2.0) for y in (-2.0, 2.0)
    }
    np.testing.assert_allclose(disk[:, 2], 0, atol=1e-5)
    radius = np.linalg.norm(disk, axis=1)
    assert (np.isclose(radius, 2, atol=1e-5) | np.isclose(radius, 0, atol=1e-5)).all()
    np.testing.assert_allclose(np.linalg.norm(cylinder[:, :2], axis=1), 2, atol=1e-5)
    assert set(cylinder[:, 2].round(5)) == {0.0, 2.0}
    np.testing.assert_allclose(np.linalg.norm(sphere, axis=1), 2, atol=1e-5)


def test_transforms_may_turn():
    """A rectangle that faces x, one unit from the origin."""
    to_world = mi.ScalarTransform4f().translate([1, 0, 0]).rotate([0, 1, 0], 90)
    found = triangles_of(mi.load_dict({"type": "rectangle", "to_world": to_world}))
    np.testing.assert_allclose(found[..., 0], 1, atol=1e-6)
    assert area(found) == pytest.approx(4)


def test_other_kinds_have_no_triangles(tmp_path):
    (tmp_path / "hair.txt").write_text("\n".join(f"{i} 0 0 0.1" for i in range(5)))
    curve = {"type": "bsplinecurve", "filename": str(tmp_path / "hair.txt")}
    assert triangles_of(mi.load_dict(curve)) is None
