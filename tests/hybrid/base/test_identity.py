"""Identities of cached results, the machine, and journals."""

from __future__ import annotations

import json
import os
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import pytest

from compose.base.errors import UserError
from hybrid.base import identity as module
from hybrid.base.identity import Journal, machine, measured_identity, require_same, require_scene, short_hash
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


pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture
def proc(monkeypatch, tmp_path):
    """An empty folder in place of /proc."""
    monkeypatch.setattr(module, "Path", lambda path: tmp_path / Path(path).relative_to("/proc"))
    return tmp_path


def test_everything_that_times_depend_on_is_there(backend):
    found = machine()
    assert found["backend"] == backend.variant
    assert found["cores"] == len(os.sched_getaffinity(0))
    assert found["packages"]["drjit"] == version("drjit")
    assert {*found["packages"]} == {"mitsuba", "drjit", "torch", "numpy"}
    assert found["version"] == version("foveated-hybrid-renderer")
    assert found["cpu"]
    assert json.loads(json.dumps(found)) == found


def test_the_processor_is_the_first_one_of_cpuinfo(proc):
    (proc / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Fast CPU: 3 GHz\n\nmodel name\t: Slow CPU\n")
    assert machine()["cpu"] == "Fast CPU: 3 GHz"


def test_without_cpuinfo_the_platform_names_the_processor(proc, monkeypatch):
    monkeypatch.setattr(module.platform, "processor", lambda: "")
    monkeypatch.setattr(module.platform, "machine", lambda: "arm64")
    assert machine()["cpu"] == "arm64"


def test_the_graphics_card_matters_on_its_backend_only(proc, monkeypatch):
    cards = proc / "driver" / "nvidia" / "gpus"
    for number, name in enumerate(("First", "Second")):
        (cards / f"000{number}").mkdir(parents=True)
        (cards / f"000{number}" / "information").write_text(f"IRQ: 12\nModel: \t {name} Card\n")
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    assert machine()["gpu"] == "First Card"
    monkeypatch.setattr(mi, "variant", lambda: "llvm_ad_rgb")
    assert machine()["gpu"] is None


def test_a_driver_that_names_no_card_is_no_error(proc, monkeypatch):
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    assert machine()["gpu"] is None


IDENTITY = {"scene": "a", "settings": {"size": (4, 5), "seed": 0}}


def test_a_result_is_computed_once(tmp_path):
    file = tmp_path / "work" / "journal.json"
    made = []
    make = lambda: made.append(1) or {"value": len(made)}  # noqa: E731
    for _ in range(2):
        assert Journal(file, IDENTITY).once("first", make) == {"value": 1}
    assert len(made) == 1
    journal = Journal(file, IDENTITY)
    assert "first" in journal
    assert "second" not in journal
    assert journal.once("second", make) == {"value": 2}
    assert Journal(file, IDENTITY)["second"] == {"value": 2}


def test_a_result_that_was_changed_in_place_is_saved_when_asked(tmp_path):
    file = tmp_path / "journal.json"
    journal = Journal(file, IDENTITY)
    journal.once("times", lambda: [[1.0]]).append([2.0])
    assert Journal(file, IDENTITY)["times"] == [[1.0]]
    journal.write()
    assert Journal(file, IDENTITY)["times"] == [[1.0], [2.0]]


def test_a_result_that_is_set_is_saved_at_once_and_replaces_the_one_before(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal["first"] = 1
    journal["first"] = 2
    assert Journal(tmp_path / "journal.json", IDENTITY)["first"] == 2


def test_nothing_is_written_before_the_first_result(tmp_path):
    Journal(tmp_path / "journal.json", IDENTITY)
    assert not list(tmp_path.iterdir())


def test_an_interruption_loses_only_the_result_in_progress(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal.once("first", lambda: 1)

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        journal.once("second", interrupted)
    assert Journal(tmp_path / "journal.json", IDENTITY).once("first", lambda: 2) == 1
    assert Journal(tmp_path / "journal.json", IDENTITY).once("second", lambda: 3) == 3


def test_a_journal_that_cannot_be_written_keeps_the_results_so_far(tmp_path, monkeypatch):
    file = tmp_path / "journal.json"
    journal = Journal(file, IDENTITY)
    journal["first"] = 1
    with pytest.raises(TypeError):
        journal["second"] = object()
    assert Journal(file, IDENTITY)["first"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["journal.json"]


def test_a_complete_evaluation_leaves_no_journal(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal["first"] = 1
    journal.remove()
    assert not list(tmp_path.iterdir())
    journal.remove()


def test_another_evaluation_is_refused(tmp_path):
    file = tmp_path / "journal.json"
    Journal(file, IDENTITY).once("first", lambda: 1)
    other = {"scene": "a", "settings": {"size": (4, 6), "seed": 0}}
    message = f"^{tmp_path}: holds results for other inputs \\(settings\\); choose another folder$"
    with pytest.raises(UserError, match=message):
        Journal(file, other)
    assert json.loads(file.read_text())["results"] == {"first": 1}


@pytest.mark.parametrize(
    "content",
    ["{", "[]", "{}", '{"identity": {}}', '{"identity": 3, "results": {}}', '{"identity": {}, "results": 3}'],
)
def test_a_damaged_file_is_named(content, tmp_path):
    file = tmp_path / "journal.json"
    file.write_text(content)
    with pytest.raises(UserError, match=r"journal\.json: is damaged .*; delete it to start again"):
        Journal(file, {})
