"""What tests of the product share."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
from typer import main as typer_main

from compose.camera.camera import Camera
from hybrid.base.progress import Steps
from hybrid.preparation import scene_look
from hybrid.preparation import scene_plan as stored
from hybrid.preparation.scene_plan import ScenePlan, plan_of
from hybrid.render import irradiance
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene
from splat.training import picture_fit
from tests.hybrid.command import TINY_CAPTURE, TINY_TRAINING, run


@pytest.fixture(scope="session", autouse=True)
def little_work() -> Iterator[None]:
    """Plans of small frames, fits of few steps, and caches of few points: enough for small scenes.

    Caches are filled once, since many tests have a cache folder of their own.
    """
    made: dict[str, IrradianceCache] = {}

    def filled(scene: Scene, cameras: list[Camera], seed: int, progress: Steps) -> IrradianceCache:
        if scene.hash not in made:
            made[scene.hash] = fill_cache(scene, cameras, seed, progress, points=1 << 13)
        progress(1, 1)
        return made[scene.hash]

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(irradiance, "fill_cache", filled)
        monkeypatch.setattr(scene_look, "_LARGER_SIDE", 128)
        monkeypatch.setattr(picture_fit, "_STEPS", 12)
        monkeypatch.setattr(picture_fit, "_PER_VIEW", 0)
        yield


@pytest.fixture(scope="session", autouse=True)
def command_line_built_once() -> Iterator[None]:
    """Each of a thousand commands would build all of them."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(typer_main, "get_command", cache(typer_main.get_command))
        yield


@pytest.fixture(scope="session", autouse=True)
def nobodys_home(tmp_path_factory) -> Iterator[None]:
    """Not the user's cache folder, whose plans may be others."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("HYBRID_HOME", str(tmp_path_factory.mktemp("home")))
        yield


@pytest.fixture(scope="session", autouse=True)
def plans_made_once() -> Iterator[None]:
    """Plans of the scenes that commands load: many tests have a cache folder of their own."""
    made: dict[str, ScenePlan] = {}

    def once(scene: Scene, *args: Any, **options: Any) -> ScenePlan:
        if scene.own_hash not in made:
            made[scene.own_hash] = plan_of(scene, *args, **options)
        return made[scene.own_hash]

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(stored, "plan_of", once)
        yield


@pytest.fixture
def own_home(monkeypatch, tmp_path_factory):
    """A cache folder of the test's own."""
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path_factory.mktemp("home")))


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A frame set and a forest of the Cornell box, made by the commands."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("HYBRID_HOME", str(folder / "home"))
        assert run(monkeypatch, "capture", "cornell", folder / "frames", *TINY_CAPTURE) == 0
        assert run(monkeypatch, "train", folder / "frames", folder / "box.forest", *TINY_TRAINING) == 0
    return folder
