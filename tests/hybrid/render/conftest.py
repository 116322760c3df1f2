"""A scene and a rough forest of it, for all tests of frames."""

from __future__ import annotations

import pytest

from hybrid.render import frame_renderer, irradiance
from hybrid.render.frame_renderer import Renderer
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest


@pytest.fixture(scope="session")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="session")
def forest(scene) -> Forest:
    return rough_forest(scene)


@pytest.fixture(scope="session")
def renderer(scene, forest) -> Renderer:
    """Without a history, and thus without any state that frames could share."""
    return Renderer(scene, forest)


@pytest.fixture
def lamp(monkeypatch):
    """A scene of its own, whose cache is filled quickly; and what sets the radiance of its lamp."""
    quick = lambda scene, *_: fill_cache(scene, [scene.camera], points=1 << 13)  # noqa: E731
    for module in (irradiance, frame_renderer):
        monkeypatch.setattr(module, "filled_cache", quick)
    scene = load_scene(small.corner())
    return scene, lambda radiance: small.set_all(scene, "emitter.radiance.value", radiance)
