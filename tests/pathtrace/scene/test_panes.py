"""Panes of glass: which shapes are some, and that light passes them straight."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene.panes import pane_faces
from pathtrace.scene.scene import load_scene
from pathtrace.scene.triangles import triangles_of
from tests import small
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")


def slab(thickness: float, bsdf: str = "dielectric") -> dict:
    """A pane across the corner, between its lamp and its walls, turned a little."""
    at = mi.ScalarTransform4f().translate([0, 1.2, 0.5]).rotate([1, 0.3, 0], 70).scale([3, 3, thickness / 2])
    return {"type": "cube", "to_world": at, "bsdf": {"type": bsdf}}


def shape(kind: str, thickness: float = 0.0) -> dict:
    return slab(thickness) if kind == "slab" else {"type": kind}


def scene(pane: dict) -> dict:
    return {**small.corner(), "pane": pane}


@pytest.mark.parametrize(
    ("kind", "thickness", "faces"),
    [
        ("slab", 0.1, 2),
        ("slab", 2.0, 0),
        ("rectangle", 0, 1),
        ("disk", 0, 1),
        ("sphere", 0, 0),
        ("cylinder", 0, 0),
        ("cube", 0, 0),
    ],
)
def test_slabs_and_sheets_are_panes(kind, thickness, faces):
    assert pane_faces(triangles_of(mi.load_dict(shape(kind, thickness)))) == faces


def test_several_panes_in_one_mesh_and_one_that_is_none():
    """Mitsuba merges meshes of one material."""
    pane, block = (triangles_of(mi.load_dict(slab(thickness))) for thickness in (0.05, 2.0))
    assert pane_faces(np.concatenate([pane, pane + 5])) == 2
    assert pane_faces(np.concatenate([pane, block + 9])) == 0


@extreme("a pane without area", given="no triangles; all corners in one point", expected="not a pane")
def test_nothing_is_no_pane(got):
    assert got(pane_faces(np.zeros((0, 3, 3)))) == 0
    assert got(pane_faces(np.ones((4, 3, 3)))) == 0


def test_it_is_part_of_the_hash_and_refused_without_panes():
    plain, thin = load_scene(scene(slab(0.05))), load_scene(scene(slab(0.05)), thin_glass=True)
    assert plain.hash != thin.hash
    assert thin.thin_glass
    with pytest.raises(UserError, match="no panes of glass"):
        load_scene(small.corner(), thin_glass=True)
