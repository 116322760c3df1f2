"""`hybrid study` from the design to the analysis, as a user runs it."""

import json
import shutil

import pytest

from tests.hybrid.command import run

SMALL = ["--size", "48", "48", "--reference-spp", "4", "--views", "2", "--attention", "1"]


@pytest.fixture(scope="module")
def study(made, tmp_path_factory):
    """A study of the Cornell box with two conditions, and two observers' answers."""
    folder = tmp_path_factory.mktemp("studies")
    conditions = folder / "conditions.json"
    wanted = {"reference": {"method": "reference"}, "splats": {"fov_a": 0.0}}
    conditions.write_text(json.dumps(wanted))
    options = ["--forest", made / "box.forest", "--conditions", conditions, *SMALL]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYBRID_HOME", str(made / "home"))
        for preset in ("pairs", "fpc"):
            command = ("study", "design", folder / preset, "cornell", "--preset", preset, *options)
            assert run(patch, *command, "--json", folder / f"{preset}.json") == 0
    return folder


@pytest.fixture
def simulated(study, tmp_path, monkeypatch):
    """Copies of both studies, with simulated answers."""
    pytest.importorskip("pyfvvdp", reason="JOD needs FovVideoVDP")
    for preset in ("pairs", "fpc"):
        shutil.copytree(study / preset, tmp_path / preset)
        assert run(monkeypatch, "study", "run", tmp_path / preset, "--simulate", 4) == 0
    return tmp_path


def test_a_design_says_how_long_it_takes(study):
    found = json.loads((study / "fpc.json").read_text())
    # Two views, one condition, three times; one anchor, and training of three.
    assert found == {"observers": 11, "trials": 2 * 3 + 1 + 3, "minutes": pytest.approx(1.5)}


def test_answers_of_simulated_observers_become_a_page(simulated, monkeypatch, capsys):
    for preset, kind in (("pairs", "choices"), ("fpc", "ratings")):
        out = simulated / f"{preset}-out"
        file = simulated / f"{preset}-out.json"
        assert run(monkeypatch, "study", "analyse", simulated / preset, "--out", out, "--json", file) == 0
        said = capsys.readouterr().out
        found = json.loads(file.read_text())
        assert found["kind"] == kind
        assert all(line in said for line in found["sentences"])
        names = {"index.html", "analysis.json", "table.csv", "table.tex", "answers.csv"}
        assert {one.name for one in out.iterdir()} == names
        # What was written is analysed alike.
        again = simulated / "again.json"
        command = ("study", "analyse", out / "answers.csv", "--out", simulated / "again", "--json", again)
        assert run(monkeypatch, *command) == 0
        assert json.loads(again.read_text())["sentences"][1:] == found["sentences"][1:]


def test_simulated_observers_follow_those_who_were_there(simulated, monkeypatch, capsys):
    assert run(monkeypatch, "study", "run", simulated / "pairs", "--simulate", 2) == 0
    assert "observers 5 to 6 were simulated" in capsys.readouterr().out


def test_the_number_of_observers_follows_from_the_effect(study, made, monkeypatch, capsys):
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    options = ["--forest", made / "box.forest", "--conditions", study / "conditions.json", *SMALL]
    command = ("study", "design", study / "fpc", "cornell", *options)
    assert run(monkeypatch, *command, "--effect", "0.5") == 0
    # Of a paired t-test: 34 pairs find d_z = .5 with a power of 80 % (Cohen 1988).
    assert "34 observers" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--preset", "acr"], "--preset acr: must be"),
        (["--stimulus", "film"], "--stimulus film: must be"),
        (["--gaze-input", "nose"], "--gaze-input nose: must be"),
        (["--stimulus", "trace"], "--gaze-trace: must be given"),
        (["--gaze-trace", "missing.csv"], "--gaze-trace: must be given"),
        (["--consent", "missing.txt"], "missing.txt: cannot be read"),
        (["--conditions", "missing.json"], "missing.json"),
        (["--forest", "a.forest", "--forest", "b.forest"], "--forest: 2 for 1 scenes"),
        (["--size", "0", "10"], "--size"),
        (["--gaze", "1.2", "0.5"], "gaze 1.2 0.5"),
        (["--effect", "0.011"], "effect"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_made(options, said, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "study", "design", tmp_path / "new", "cornell", *options) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]
    assert not (tmp_path / "new" / "study.json").exists()


@pytest.mark.parametrize("command", ["run", "analyse"])
def test_a_folder_without_a_study_is_one_line(command, monkeypatch, tmp_path, capsys):
    options = ["--out", tmp_path / "out"] if command == "analyse" else ["--simulate", "1"]
    assert run(monkeypatch, "study", command, tmp_path, *options) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "holds no study" in lines[0]
    assert not (tmp_path / "out").exists()


def test_columns_are_named(monkeypatch, tmp_path, capsys):
    file = tmp_path / "votes.csv"
    rows = [f"P{n},{c},{3 + (n + len(c)) % 2}" for n in range(5) for c in ("ours", "theirs")]
    file.write_text("\n".join(["person,method,score", *rows]) + "\n")
    names = ["--column", "observer=person", "--column", "condition=method", "--column", "vote=score"]
    assert run(monkeypatch, "study", "analyse", file, "--out", tmp_path / "out", *names) == 0
    assert capsys.readouterr().out.startswith("5 observers gave 10 votes.")
    assert run(monkeypatch, "study", "analyse", file, "--out", tmp_path / "out", "--column", "vote") == 2
    assert "--column vote: must be NAME=COLUMNS" in capsys.readouterr().err
