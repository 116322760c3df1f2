"""What rays hit first, behind mirrors, glass and media, and the auxiliary features of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.base.traced_samples import DIFFUSE, GLOSSY, SPECULAR
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.optics import Optics
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import box_positions, clipped, frame_positions, opaque_camera, ray_through
from pathtrace.trace.first_hit import (
    AuxiliaryFeatures,
    Unseen,
    Veil,
    auxiliary_features,
    auxiliary_hits,
    first_hits,
    has_clear_surfaces,
    veil,
)
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
COLOUR = [0.7, 0.4, 0.2]
MIRROR = {"type": "conductor", "material": "none"}
# Mitsuba starts reflected rays a little off the surface.
OFFSET = 1e-4
BALL = {"type": "sphere", "center": [0, 0, 1], "radius": 0.5}


def wall(z: float, turn: float = 0, scale: float = 20, **bsdf) -> dict:
    """A square wall that faces +z, or -z if turned by 180 degrees."""
    bsdf = bsdf or {"type": "diffuse", "reflectance": {"type": "rgb", "value": COLOUR}}
    transform = mi.ScalarTransform4f().translate([0, 0, z]).rotate([0, 1, 0], turn).scale(scale)
    return {"type": "rectangle", "to_world": transform, "bsdf": bsdf}


def looking_at(thing: dict, behind: bool = True, beyond: bool = True) -> dict:
    """A camera at z = -1 that looks along +z at a thing at z = 1; a wall behind it at -3, one beyond at 4."""
    pose = mi.ScalarTransform4f().look_at(origin=[0, 0, -1], target=[0, 0, 1], up=[0, 1, 0])
    return {
        "type": "scene",
        "sensor": {**small.sensor(16, 16, 10.0), "to_world": pose},
        "thing": thing,
        **({"behind": wall(-3)} if behind else {}),
        **({"beyond": wall(4, 180)} if beyond else {}),
        "lamp": {"type": "point", "position": [0, 5, -1], "intensity": {"type": "rgb", "value": 5.0}},
    }


def features(thing: dict, **walls: bool):
    """Albedo, normal, position (N, 3) and gloss (N,) of a view of the thing."""
    scene = load_scene(looking_at(thing, **walls))
    found = Tracer(scene).auxiliary(scene.camera, frame_positions(scene.camera), 4, 0)
    image = lambda channels: np.stack([c.numpy() for c in channels], axis=-1)  # noqa: E731
    return image(found.albedo), image(found.normal), image(found.position), found.gloss.numpy()


@dataclass(frozen=True)
class Path:
    """First hit of the single ray from z = -1 straight ahead; `end` is None if the path leaves the scene."""

    distance: float
    unfolded: float
    end: float | None
    throughput: list[float]
    flat: bool


def straight(thing: dict, bounces: int = 8, **walls: bool) -> Path:
    scene = mi.load_dict(looking_at(thing, **walls))
    hits = first_hits(scene, mi.Ray3f([0, 0, -1], [0, 0, 1]), mi.Bool(True), bounces)
    dr.eval(hits)
    end = float(hits.last.p.z[0]) if hits.last.is_valid()[0] else None
    throughput = np.array(hits.throughput).ravel().tolist()
    return Path(float(hits.surface.t[0]), float(hits.unfolded[0]), end, throughput, bool(hits.flat[0]))


def test_a_rough_surface_ends_the_path():
    path = straight(wall(1, 180))
    assert path.distance == path.unfolded == pytest.approx(2)
    assert path.end == pytest.approx(1)
    assert path.throughput == [1, 1, 1]
    assert path.flat


def test_a_flat_mirror_is_followed():
    """From -1 to the mirror at 1, and back to the wall at -3: 2 + 4."""
    tint = {"specular_reflectance": {"type": "rgb", "value": [0.5, 0.25, 1.0]}}
    path = straight(wall(1, 180, **MIRROR, **tint))
    assert path.distance == pytest.approx(2)
    assert path.unfolded == pytest.approx(6, rel=OFFSET)
    assert path.end == pytest.approx(-3)
    assert path.throughput == pytest.approx([0.5, 0.25, 1], rel=1e-5)
    assert path.flat


def test_a_black_mirror_ends_the_path():
    path = straight(wall(1, 180, **MIRROR, specular_reflectance=0.0))
    assert path.distance == path.unfolded == pytest.approx(2)
    assert path.end == pytest.approx(1)
    assert path.throughput == [1, 1, 1]


def test_glass_is_looked_through():
    path = straight(wall(1, 180, type="thindielectric"))
    assert path.unfolded == pytest.approx(5, rel=OFFSET)
    assert path.end == pytest.approx(4)
    assert not path.flat


def test_a_curved_mirror_is_followed_but_not_flat():
    """The ball's front is at 0.5."""
    path = straight({**BALL, "bsdf": MIRROR})
    assert path.unfolded == pytest.approx(1.5 + 3.5, rel=OFFSET)
    assert not path.flat


def test_a_path_that_leaves_the_scene_ends_at_the_mirror():
    path = straight(wall(1, 180, **MIRROR), behind=False)
    assert path.end is None
    assert path.distance == path.unfolded == pytest.approx(2)


@pytest.mark.parametrize("bounces", [0, 1, 3, 8])
def test_as_many_bounces_as_asked_for(bounces):
    """Two mirrors, 3 apart, face each other; each bounce halves the light."""
    grey = {**MIRROR, "specular_reflectance": 0.5}
    scene = mi.load_dict({"type": "scene", "front": wall(1, 180, **grey), "back": wall(-2, **grey)})
    ray = mi.Ray3f([0, 0, -1], [0, 0, 1])
    hits = first_hits(scene, ray, mi.Bool(True), bounces)
    default = first_hits(scene, ray, mi.Bool(True))
    dr.eval(hits, default)
    assert hits.unfolded[0] == pytest.approx(2 + 3 * bounces, rel=OFFSET)
    assert hits.throughput.x[0] == pytest.approx(0.5**bounces)
    # Eight, unless said otherwise.
    assert default.unfolded[0] == pytest.approx(2 + 3 * 8, rel=OFFSET)
    # Auxiliary features follow four bounces, if there is anything to follow.
    for clear, z in ((True, -1 + 2 + 12), (False, 1)):
        found = auxiliary_features(auxiliary_hits(scene, ray, mi.Bool(True), clear), ray, mi.Bool(True))
        assert found.position[2][0] == pytest.approx(z, rel=OFFSET)


@pytest.mark.parametrize(
    ("bsdf", "clear"),
    [
        ("diffuse", False),
        ("roughconductor", False),
        ("plastic", False),
        ("conductor", True),
        ("dielectric", True),
    ],
)
def test_mirrors_and_glass_are_clear_surfaces(bsdf, clear):
    scene = mi.load_dict({"type": "scene", "a": {"type": "cube"}, "b": {**BALL, "bsdf": {"type": bsdf}}})
    assert has_clear_surfaces(scene) is clear


def test_a_flat_mirror_shows_what_appears_to_stand_still_behind_it():
    mirror = {"type": "conductor", "specular_reflectance": {"type": "rgb", "value": 0.5}}
    albedo, normal, position, gloss = features(wall(1, 180, **mirror))
    # The wall at z = -3 is 4 in front of the mirror at z = 1; its image is as far behind it.
    np.testing.assert_allclose(position[:, 2], 5, atol=1e-3)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1], normal.shape), atol=1e-5)
    tint = albedo / np.array(COLOUR)
    assert tint.min() > 0.3
    assert tint.max() < 0.51
    assert (gloss == DIFFUSE).all()


@pytest.mark.parametrize("bsdf", ["conductor", "dielectric"])
def test_what_a_ball_shows_lies_on_it(bsdf):
    albedo, _, position, gloss = features({**BALL, "bsdf": {"type": bsdf}})
    np.testing.assert_allclose(np.linalg.norm(position - [0, 0, 1], axis=1), 0.5, atol=1e-4)
    assert (gloss == SPECULAR).all()
    # One of the two walls, mirrored or through the glass; a thin rim shows the floorless sides.
    assert (albedo[:, 0] > albedo[:, 2]).mean() > 0.9


def test_what_glass_shows_lies_on_it_even_if_flat():
    albedo, normal, position, gloss = features(wall(1, 180, type="thindielectric"))
    np.testing.assert_allclose(position[:, 2], 1, atol=1e-4)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, -1], normal.shape), atol=1e-5)
    assert (gloss == SPECULAR).all()
    assert (albedo[:, 0] > 0.5).all()


@pytest.mark.parametrize(
    ("bsdf", "expected"),
    [
        ({"type": "diffuse"}, DIFFUSE),
        ({"type": "roughconductor"}, GLOSSY),
        ({"type": "plastic"}, SPECULAR),
        # Both: what is sharpest counts.
        (
            {"type": "blendbsdf", "a": {"type": "plastic"}, "b": {"type": "roughconductor"}, "weight": 0.5},
            SPECULAR,
        ),
    ],
)
def test_gloss_of_the_first_surface(bsdf, expected):
    _, normal, position, gloss = features({**BALL, "bsdf": bsdf})
    assert (gloss == expected).all()
    np.testing.assert_allclose(np.linalg.norm(position - [0, 0, 1], axis=1), 0.5, atol=1e-4)
    # Means over a pixel of unit vectors that point towards the camera.
    assert (normal[:, 2] < -0.9).all()


def test_a_diffuse_surface_has_its_reflectance_as_albedo():
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}
    albedo, _, position, gloss = features(wall(1, 180, **diffuse))
    np.testing.assert_allclose(position[:, 2], 1, atol=1e-5)
    np.testing.assert_allclose(albedo, np.broadcast_to([0.1, 0.2, 0.3], albedo.shape), atol=1e-5)
    assert (gloss == DIFFUSE).all()


def test_normals_are_shading_normals(tmp_path):
    """A triangle at z = 1 whose vertices say that it leans."""
    corners = "".join(f"v {x} {y} 1\n" for x, y in ((-9, -9), (9, -9), (0, 9)))
    (tmp_path / "leaning.obj").write_text(corners + "vn 0.6 0 -0.8\nf 3//1 2//1 1//1\n")
    _, normal, _, _ = features({"type": "obj", "filename": str(tmp_path / "leaning.obj")})
    np.testing.assert_allclose(normal, np.broadcast_to([0.6, 0, -0.8], normal.shape), atol=1e-5)


def assert_sky(found) -> None:
    albedo, normal, position, gloss = found
    assert not albedo.any()
    assert not normal.any()
    np.testing.assert_allclose(np.linalg.norm(position - [0, 0, -1], axis=1), 1e18, rtol=1e-4)
    assert (position[:, 2] > 0).all()
    assert (gloss == DIFFUSE).all()


def test_the_sky_is_black_and_far_away():
    assert_sky(features({**BALL, "center": [50, 0, 0]}, beyond=False))
    # As well in a flat mirror.
    assert_sky(features(wall(1, 180, **MIRROR), behind=False))


def test_sky_in_a_curved_mirror_lies_on_it():
    albedo, _, position, gloss = features({**BALL, "bsdf": MIRROR}, behind=False, beyond=False)
    assert not albedo.any()
    assert (gloss == SPECULAR).all()
    np.testing.assert_allclose(np.linalg.norm(position - [0, 0, 1], axis=1), 0.5, atol=1e-4)


def test_inactive_rays_see_the_sky():
    scene = mi.load_dict(looking_at(wall(1, 180)))
    ray = mi.RayDifferential3f([0, 0, -1], mi.Vector3f([0, 0], [0, 0], [1, 1]))
    active = mi.Bool([True, False])
    found = auxiliary_features(auxiliary_hits(scene, ray, active, True), ray, active)
    np.testing.assert_allclose(found.albedo[0].numpy(), [0.7, 0], atol=1e-6)
    np.testing.assert_allclose(found.normal[2].numpy(), [-1, 0], atol=1e-6)
    np.testing.assert_allclose(found.position[2].numpy(), [1, 1e18], rtol=1e-4)


FORWARD = [0, 0, 1]


def behind(sigma: float, **more: Any) -> Any:
    """A wall at z = 3, and a cube of a medium of albedo 0.6 in front of it, from z = 0 to 2."""
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).scale(9)}
    medium = {"type": "homogeneous", "albedo": 0.6, "sigma_t": sigma}
    place = mi.ScalarTransform4f().translate([0, 0, 1])
    cube = {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}
    return mi.load_dict({"type": "scene", "wall": wall, "smoke": cube, **more})


def ray_from(z: float) -> Any:
    return mi.Ray3f(mi.Point3f(0, 0, z), mi.Vector3f(*FORWARD))


@pytest.mark.parametrize("sigma", [0.1, 1.0, 3.0, 50.0])
def test_a_medium_hides_what_hardly_any_light_passes(sigma):
    found = veil(behind(sigma), ray_from(-1), None, mi.Bool(True))
    left = np.exp(-2 * sigma)
    assert found.transmittance[0] == pytest.approx(left, rel=1e-3, abs=1e-6)
    assert np.array(found.albedo).ravel() == pytest.approx(np.full(3, 0.6 * (1 - left)), rel=1e-3)
    # Half of the light is left at ln 2 / sigma from the front, at a distance of 1.
    assert found.half[0] == pytest.approx(1 + np.log(2) / sigma if left < 0.05 else np.inf, rel=1e-3)


def test_a_ray_that_starts_in_a_medium_is_in_it_from_its_start():
    scene = behind(3.0)
    inside = scene.shapes()[1].interior_medium() or scene.shapes()[0].interior_medium()
    found = veil(scene, ray_from(0.5), inside, mi.Bool(True))
    assert found.half[0] == pytest.approx(np.log(2) / 3, rel=1e-3)
    assert found.transmittance[0] == pytest.approx(np.exp(-4.5), rel=1e-3)


def test_the_sky_is_seen_through_a_medium_without_an_end():
    scene = mi.load_dict({"type": "scene", "fog": {"type": "homogeneous", "sigma_t": 2.0}, **small.furnace()})
    medium = load_scene(
        {
            **small.furnace(),
            "fog": {"type": "homogeneous", "sigma_t": 2.0},
            "sensor": {**small.sensor(), "medium": {"type": "ref", "id": "fog"}},
        }
    ).optics.medium
    found = veil(scene, mi.Ray3f([0, 0, 9], FORWARD), medium, mi.Bool(True))
    assert found.half[0] == np.inf


def test_features_of_media_are_matt_and_face_the_ray():
    known = AuxiliaryFeatures(
        [mi.Float(0.2)] * 3, list(mi.Vector3f(1, 0, 0)), [mi.Float(9)] * 3, mi.Float(SPECULAR)
    )
    ray = ray_from(0)
    thick = Veil(mi.Float(2), mi.Float(0.25), mi.Color3f(0.5)).over(known, ray)
    assert [v[0] for v in thick.albedo] == pytest.approx([0.2 * 0.25 + 0.5] * 3)
    assert [v[0] for v in thick.normal] == pytest.approx([0.25, 0, -0.75])
    assert [v[0] for v in thick.position] == pytest.approx([0, 0, 2])
    assert thick.gloss[0] == DIFFUSE
    thin = Veil(mi.Float(dr.inf), mi.Float(1), mi.Color3f(0)).over(known, ray)
    assert [v[0] for v in (*thin.albedo, *thin.normal, *thin.position, thin.gloss)] == [
        *[pytest.approx(0.2)] * 3, 1, 0, 0, 9, 9, 9, SPECULAR
    ]  # fmt: skip


def test_rays_pass_what_cameras_do_not_see():
    lamp = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -0.5])}
    scene = behind(1.0, lamp={**lamp, "emitter": {"type": "area"}})
    distance = {
        sides: first_hits(scene, ray_from(-1), mi.Bool(True), 0, sides and Unseen(*sides)).surface.t[0]
        for sides in (None, (True, False), (False, True), (True, True))
    }
    assert list(distance.values()) == pytest.approx([0.5, 1, 0.5, 4], rel=1e-3)
    assert Unseen.of(scene, True) == Unseen(True, True)
    assert Unseen.of(mi.load_dict(small.corner()), False) is None


def test_rays_lie_between_clipping_planes():
    camera = load_scene(small.furnace()).camera
    numbers = opaque_camera(camera)
    ray = ray_through(numbers, mi.Float([0.5, 16, 31]), mi.Float([3.5, 16, 8]))
    within, start = clipped(ray, numbers, (0.4, 2.0))
    forward = mi.Vector3f(camera.camera_to_world[:3, 2])
    eye = mi.Point3f(camera.position)
    for at, depth in ((within.o, 0.4), (within(within.maxt), 2.0)):
        assert np.array(dr.dot(at - eye, forward)) == pytest.approx(np.full(3, depth), rel=1e-5)
    assert np.array(dr.norm(within.o - eye)) == pytest.approx(start.numpy(), rel=1e-5)


def test_hits_are_as_far_from_the_eye_whatever_is_clipped_in_front():
    scene = load_scene(small.corner())
    at = box_positions(*(np.full(1, value) for value in (20.0, 12.0, 1.0, 1.0)))
    whole = Tracer(scene).hits(scene.camera, at)
    beyond = Tracer(replace(scene, optics=Optics(clips=(0.2, 90.0)))).hits(scene.camera, at)
    assert beyond.distance == pytest.approx(whole.distance, rel=1e-5)
    cut = Tracer(replace(scene, optics=Optics(clips=(0.2, 0.5)))).hits(scene.camera, at)
    assert cut.distance[0] == np.inf


def test_no_cache_stands_for_light_in_media():
    scene = replace(load_scene(small.corner()), optics=Optics(has_media=True))
    assert len(fill_cache(scene, [scene.camera]).cells) == 0
