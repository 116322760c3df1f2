"""Results of different settings are never mixed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from compose.base.errors import UserError
from hybrid.base import identity as module
from hybrid.base.identity import machine, measured_identity, require_same, require_scene, short_hash
from tests.extremes import extreme
from tests.hybrid.forests import white_dot


def test_the_order_of_entries_does_not_matter_and_their_values_do():
    hashed = short_hash({"a": 1, "b": [2, 3]})
    assert short_hash({"b": [2, 3], "a": 1}) == hashed
    assert short_hash({"a": 1, "b": [3, 2]}) != hashed
    assert short_hash({"a": 1}) != hashed
    assert len(hashed) == 12
    assert int(hashed, 16) >= 0


def test_equal_identities_are_the_same_also_as_json_gives_them_back():
    require_same({"size": [4, 5], "seed": 0}, {"size": (4, 5), "seed": 0}, "f", "g")


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ({"a": 1, "b": 2, "c": 4}, "c"),
        ({"a": 0, "b": 2, "c": 0}, "a, c"),
        ({"a": 1, "b": 2}, "c"),
        ({"a": 1, "b": 2, "c": 3, "d": 4}, "d"),
        ({}, "a, b, c"),
    ],
)
def test_what_differs_is_named(found, named):
    with pytest.raises(UserError, match=rf"^f: holds work for other inputs \({named}\); go away$"):
        require_same(found, {"a": 1, "b": 2, "c": 3}, "f: holds work", "go away")


def item(name: str, digest: str) -> SimpleNamespace:
    return SimpleNamespace(scene_name=name, scene_hash=digest)


def test_a_forest_fits_its_own_scene_and_an_imported_one_fits_any():
    require_scene(item("room", "ab" * 32), "room", "ab" * 32, "file")
    require_scene(item("room", ""), "cornell", "ab" * 32, "file")


def test_what_belongs_to_another_scene_is_refused():
    with pytest.raises(UserError) as refused:
        require_scene(item("room", "ab" * 32), "cornell", "cd" * 32, "a.forest")
    assert str(refused.value) == "a.forest belongs to scene room (abababab), not to cornell (cdcdcdcd)"


def test_another_version_of_the_same_scene_is_refused_with_a_reason():
    with pytest.raises(UserError, match=r"; the scene or its path depth has changed$"):
        require_scene(item("room", "ab" * 32), "room", "cd" * 32, "a.forest")


def test_measurements_depend_on_scene_depth_forest_settings_and_machine(backend):
    forest, other = white_dot((0, 0, 1)), white_dot((0, 0, 1), opacity_logit=7.0)
    scene = SimpleNamespace(hash="ab" * 32, max_depth=8, roulette_depth=5)
    identity = measured_identity(scene, forest, spp=4)
    assert identity["machine"] == machine()
    assert identity["spp"] == 4
    deeper = SimpleNamespace(hash="ab" * 32, max_depth=9, roulette_depth=5)
    changed = SimpleNamespace(hash="cd" * 32, max_depth=8, roulette_depth=5)

    others = [
        measured_identity(deeper, forest, spp=4),
        measured_identity(changed, forest, spp=4),
        measured_identity(scene, other, spp=4),
        measured_identity(scene, forest, spp=5),
    ]
    assert len({short_hash(one) for one in [identity, *others]}) == 5


@extreme(
    "equal time after an update",
    given="a source file of the project, or the denoiser's version, has changed",
    expected="another identity: what was stored is measured anew",
)
def test_measurements_of_other_code_are_not_used(backend, monkeypatch, tmp_path, got):
    forest, scene = white_dot((0, 0, 1)), SimpleNamespace(hash="ab" * 32, max_depth=8, roulette_depth=5)

    def identity() -> str:
        module.code.cache_clear()
        return short_hash(measured_identity(scene, forest))

    found = [identity(), identity()]
    monkeypatch.setattr(module, "version", lambda name: "99")
    found.append(identity())
    monkeypatch.undo()
    # A copy of the project, in which a line is added to one file.
    source = Path(module.__file__).parents[2]
    for package in ("compose", "hybrid", "pathtrace", "splat"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "a.py").write_bytes((source / package / "__init__.py").read_bytes())
    (tmp_path / "hybrid" / "store").mkdir()
    monkeypatch.setattr(module, "__file__", str(tmp_path / "hybrid" / "store" / "identity.py"))
    found.append(identity())
    (tmp_path / "splat" / "a.py").write_text("changed = True\n")
    found.append(identity())
    monkeypatch.undo()
    module.code.cache_clear()
    assert found[0] == found[1]
    assert got(len(set(found))) == 4
