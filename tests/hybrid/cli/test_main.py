"""The command line as a whole: which function each command calls, and how a mistake ends."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from compose.base.errors import UserError
from hybrid.cli import main as module
from hybrid.cli.bench import bench_app, frame, gaze, integrator, moving, periphery, raster
from hybrid.cli.capture import capture
from hybrid.cli.demo import demo
from hybrid.cli.doctor import doctor
from hybrid.cli.evaluate import evaluate
from hybrid.cli.exchange import export_file, import_file
from hybrid.cli.main import app, main
from hybrid.cli.many_machines import merge
from hybrid.cli.prepare import plan, prepare, quickstart
from hybrid.cli.render import render
from hybrid.cli.scenes import scenes
from hybrid.cli.serve import serve
from hybrid.cli.study import analyse, design, study_app
from hybrid.cli.study import run as run_study
from hybrid.cli.sweep import sweep
from hybrid.cli.train import levels, train
from tests.hybrid.command import run

ROOT = Path(__file__).resolve().parents[3]
COMMANDS = {
    "doctor": doctor,
    "scenes": scenes,
    "quickstart": quickstart,
    "plan": plan,
    "prepare": prepare,
    "capture": capture,
    "train": train,
    "levels": levels,
    "render": render,
    "demo": demo,
    "serve": serve,
    "evaluate": evaluate,
    "sweep": sweep,
    "merge": merge,
    "export": export_file,
    "import": import_file,
}
BENCHES = {
    "raster": raster,
    "integrator": integrator,
    "periphery": periphery,
    "frame": frame,
    "moving": moving,
    "gaze": gaze,
}


STUDY = {"design": design, "run": run_study, "analyse": analyse}


def commands_of(application: typer.Typer) -> dict:
    return dict(typer.main.get_command(application).commands)


@pytest.mark.parametrize(
    ("application", "expected"), [(app, COMMANDS), (bench_app, BENCHES), (study_app, STUDY)]
)
def test_each_command_calls_its_function(application, expected):
    found = commands_of(application)
    for group in ("bench", "study"):
        found.pop(group, None)
    called = {name: inspect.unwrap(command.callback) for name, command in found.items()}
    assert called == {name: inspect.unwrap(command) for name, command in expected.items()}


def test_groups_have_their_commands():
    assert {*commands_of(app)["bench"].commands} == {*BENCHES}
    assert {*commands_of(app)["study"].commands} == {*STUDY}


@pytest.mark.parametrize(
    "name", [*COMMANDS, *(f"bench {name}" for name in BENCHES), *(f"study {name}" for name in STUDY)]
)
def test_every_command_and_option_has_help(name):
    command = typer.main.get_command(app)
    for word in name.split():
        command = command.commands[word]
    assert command.help
    for parameter in command.params:
        # A bench of the rasterizer has Gaussians, quickstart has a scene; nothing is left to say.
        if parameter.name not in ("gaussians", "scene", "help"):
            assert parameter.help, parameter.name


def test_json_is_checked_before_the_work_by_every_command_but_export_and_import():
    commands = commands_of(app)
    commands |= commands.pop("bench").commands | commands.pop("study").commands
    checks = {
        name: parameter.callback
        for name, command in commands.items()
        for parameter in command.params
        if "--json" in parameter.opts
    }
    assert {*commands} - {*checks} == {"export", "import"}
    assert all(checks.values())


def test_help_appears_without_loading_a_renderer():
    program = (
        "import sys; from hybrid.cli.main import app; "
        "app(['render', '--help'], standalone_mode=False); "
        "print([name for name in ('torch', 'mitsuba', 'drjit') if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip().endswith("[]")
    assert "--fov-a" in result.stdout


def test_a_users_mistake_is_one_line_and_exit_code_2(monkeypatch, capsys):
    def mistaken() -> None:
        raise UserError("file.xml: is wrong; must be right")

    monkeypatch.setattr(module, "app", mistaken)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert capsys.readouterr() == ("", "hybrid: file.xml: is wrong; must be right\n")


def test_an_error_of_the_program_is_not_hidden(monkeypatch):
    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(module, "app", broken)
    with pytest.raises(ZeroDivisionError):
        main()


def test_without_a_command_help_is_shown(monkeypatch, capsys):
    assert run(monkeypatch) == 2
    shown = capsys.readouterr()
    assert "quickstart" in shown.out + shown.err


def test_any_locale_and_the_backend_of_a_notebook_do_no_harm(tmp_path):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "MPLBACKEND": "module://of_a_notebook"}
    program = """
import sys
from hybrid.cli.main import main
for command in (["scenes", "--json", sys.argv[1]], ["render", "r\u00f6m", "-o", "a.png"]):
    sys.argv[1:] = command
    try:
        main()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    import matplotlib.pyplot
    matplotlib.pyplot.figure()
    print("r\u00f6m", code, flush=True)
"""
    command = [sys.executable, "-c", program, str(tmp_path / "s.json")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    ends = [line for line in done.stdout.splitlines() if line.startswith("r?m")]
    assert ends == ["r?m 0", "r?m 2"]
    assert done.stderr.count("\n") == 1
    assert "no such scene" in done.stderr
