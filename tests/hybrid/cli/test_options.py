"""What commands share: checks of files and sizes, and the file of --json."""

from __future__ import annotations

import json

import pytest
import typer

from compose.base.errors import UserError
from hybrid.cli.main import app
from hybrid.cli.options import (
    loaded_scene,
    option_names,
    require_size,
    select,
    sized,
    user_errors,
    write_json,
)
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.render.frame_settings import DEFAULTS, EVALUATION, INTERACTIVE

FRAME_OPTIONS = {"fov_a": "fov_a", "fov_b": "fov_b", "spp": "spp", "acuity_model": "acuity_model"}


def defaults_of(name: str) -> dict[str, object]:
    command = typer.main.get_command(app)
    for word in name.split():
        command = command.commands[word]
    return {parameter.name: parameter.default for parameter in command.params}


@pytest.mark.parametrize(
    ("command", "settings"),
    [
        ("render", DEFAULTS),
        ("quickstart", DEFAULTS),
        ("demo", INTERACTIVE),
        ("evaluate", EVALUATION),
    ],
)
def test_options_of_a_frame_default_to_the_settings_of_their_use(command, settings):
    defaults = defaults_of(command)
    found = {name: defaults[name] for name in FRAME_OPTIONS if name in defaults}
    assert {"fov_a", "fov_b"} <= {*found}
    assert found == {name: getattr(settings, name) for name in found}
    # Left out, it follows from the plan and the settings.
    assert defaults.get("fovea") in (None, settings.fovea.value)
    assert defaults.get("display", "desktop") == "desktop"
    assert defaults.get("seed", 0) == 0


def test_options_of_an_evaluation_default_to_its_settings():
    defaults, settings = defaults_of("evaluate"), EvaluationSettings()
    assert tuple(defaults["size"]) == (settings.width, settings.height)
    for name in ("views", "apart", "seeds", "reference_spp", "repeats", "quick"):
        assert defaults[name] == getattr(settings, name)
    assert defaults["raw_references"] is not settings.denoised_references


def test_settings_that_are_out_of_range_are_the_users_mistake():
    def work() -> None:
        with user_errors():
            raise ValueError("views is 0; must be positive")

    with pytest.raises(UserError, match=r"^views is 0; must be positive$"):
        work()


def test_messages_about_settings_name_options():
    def named(message: str) -> str:
        with pytest.raises(UserError) as refused, option_names("psnr", "held_out", most="clamp-indirect"):
            raise UserError(message)
        return str(refused.value)

    assert named("held_out -1: psnr") == "--held-out -1: psnr"
    assert named("psnr and held_out 0: one of them") == "--psnr and --held-out 0: one of them"
    assert named("most 0: too few") == "--clamp-indirect 0: too few"
    assert named("file: psnr") == "file: psnr"


def test_other_errors_are_not_the_users():
    def work() -> None:
        with user_errors():
            raise KeyError("views")

    with pytest.raises(KeyError):
        work()


def test_an_unknown_backend_is_refused(backend):
    select("auto")
    with pytest.raises(UserError, match="backend metal"):
        select("metal")


def test_a_camera_is_resized_if_a_size_is_given(backend):
    camera = loaded_scene("cornell").camera
    assert sized(camera, None) is camera
    assert sized(camera, (40, 30)) == camera.resized(40, 30)
    for size in ((0, 30), (40, -1)):
        with pytest.raises(UserError, match=f"^--size {size[0]} {size[1]}: must be positive$"):
            sized(camera, size)


def test_a_size_may_have_a_minimum():
    require_size((64, 64), least=64)
    require_size((1, 1))
    with pytest.raises(UserError, match=r"^--size 64 63: must be at least 64 each$"):
        require_size((64, 63), least=64)


def test_another_path_depth_is_another_scene(backend):
    assert loaded_scene("cornell", 2).max_depth == 2


def test_json_is_written_if_asked_for(tmp_path):
    write_json(None, {"a": 1})
    assert not list(tmp_path.iterdir())
    write_json(tmp_path / "a.json", {"a": [1, 2.5]})
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == {"a": [1, 2.5]}
    assert text == '{\n "a": [\n  1,\n  2.5\n ]\n}\n'


def test_json_files_know_no_numbers_that_are_not_finite(tmp_path):
    write_json(tmp_path / "a.json", {"a": [float("nan"), float("inf"), 1.5]})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [None, None, 1.5]}
    assert "NaN" not in (tmp_path / "a.json").read_text()
