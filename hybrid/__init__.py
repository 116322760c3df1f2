"""Foveated hybrid rendering: a path-traced fovea and a Gaussian-splat periphery in one frame.

    >>> import hybrid
    >>> scene = hybrid.load_scene("room")
    >>> forest = hybrid.load_forest("room.forest")
    >>> frame = hybrid.Renderer(scene, forest).frame(hybrid.FrameSettings(gaze=(0.4, 0.6), spp=4))
    >>> frame.save("frame.exr")

Names are imported when they are first used, so that `import hybrid` takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

# Points Dr.Jit to a good LLVM, before anything imports Dr.Jit.
import compose  # noqa: F401

if TYPE_CHECKING:
    from compose.base.errors import UserError as UserError
    from compose.camera.camera import Camera as Camera
    from compose.eye.display import Display as Display
    from compose.eye.gaze import Gaze as Gaze
    from compose.fovea.mode import FoveaMode as FoveaMode
    from hybrid.api.evaluation import evaluate as evaluate
    from hybrid.api.scenes import capture as capture
    from hybrid.api.scenes import load_forest as load_forest
    from hybrid.api.scenes import load_frames as load_frames
    from hybrid.api.scenes import load_scene as load_scene
    from hybrid.api.scenes import prepare as prepare
    from hybrid.api.scenes import train as train
    from hybrid.evaluation.settings import EvaluationSettings as EvaluationSettings
    from hybrid.frame.frame import Frame as Frame
    from hybrid.frame.renderer import Renderer as Renderer
    from hybrid.frame.settings import FrameSettings as FrameSettings
    from hybrid.frame.splat_renderer import SplatRenderer as SplatRenderer
    from hybrid.preparation.settings import PreparationSettings as PreparationSettings
    from pathtrace.base.backend import select_backend as select_backend
    from pathtrace.dataset.frames import FrameSet as FrameSet
    from pathtrace.dataset.settings import CaptureSettings as CaptureSettings
    from pathtrace.scene.scene import Scene as Scene
    from splat.model.forest import Forest as Forest
    from splat.training.trainer import TrainingSettings as TrainingSettings

_MODULES = {
    "Camera": "compose.camera.camera",
    "CaptureSettings": "pathtrace.dataset.settings",
    "Display": "compose.eye.display",
    "EvaluationSettings": "hybrid.evaluation.settings",
    "Forest": "splat.model.forest",
    "FoveaMode": "compose.fovea.mode",
    "Frame": "hybrid.frame.frame",
    "FrameSet": "pathtrace.dataset.frames",
    "FrameSettings": "hybrid.frame.settings",
    "Gaze": "compose.eye.gaze",
    "PreparationSettings": "hybrid.preparation.settings",
    "Renderer": "hybrid.frame.renderer",
    "Scene": "pathtrace.scene.scene",
    "SplatRenderer": "hybrid.frame.splat_renderer",
    "TrainingSettings": "splat.training.trainer",
    "UserError": "compose.base.errors",
    "capture": "hybrid.api.scenes",
    "evaluate": "hybrid.api.evaluation",
    "load_forest": "hybrid.api.scenes",
    "load_frames": "hybrid.api.scenes",
    "load_scene": "hybrid.api.scenes",
    "prepare": "hybrid.api.scenes",
    "select_backend": "pathtrace.base.backend",
    "train": "hybrid.api.scenes",
}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULES})
