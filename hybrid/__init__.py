"""Foveated hybrid rendering: a path-traced fovea and a Gaussian-splat periphery in one frame.

    >>> import hybrid
    >>> scene = hybrid.load_scene("room")
    >>> forest = hybrid.load_forest("room.forest")
    >>> frame = hybrid.Renderer(scene, forest).frame(hybrid.FrameSettings(gaze=(0.4, 0.6), spp=4))
    >>> frame.save("frame.exr")

Names are imported when they are first used, so that `import hybrid` takes no time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

# Imports compose, which points Dr.Jit to a good LLVM, before anything imports Dr.Jit.
from compose.base.startup import names_on_demand

if TYPE_CHECKING:
    from compose.base.errors import UserError as UserError
    from compose.camera.camera import Camera as Camera
    from compose.eye.display import Display as Display
    from compose.eye.gaze import Gaze as Gaze
    from compose.fovea.foveation import FoveaMode as FoveaMode
    from hybrid.api.workflow import capture as capture
    from hybrid.api.workflow import evaluate as evaluate
    from hybrid.api.workflow import load_forest as load_forest
    from hybrid.api.workflow import load_frames as load_frames
    from hybrid.api.workflow import load_scene as load_scene
    from hybrid.api.workflow import plan as plan
    from hybrid.api.workflow import prepare as prepare
    from hybrid.api.workflow import train as train
    from hybrid.evaluation.evaluation_settings import EvaluationSettings as EvaluationSettings
    from hybrid.preparation.stages import PreparationSettings as PreparationSettings
    from hybrid.render.frame import Frame as Frame
    from hybrid.render.frame_renderer import Renderer as Renderer
    from hybrid.render.frame_settings import FrameSettings as FrameSettings
    from hybrid.render.splat_renderer import SplatRenderer as SplatRenderer
    from hybrid.window.notebook import show as show
    from pathtrace.dataset.frame_set import CaptureSettings as CaptureSettings
    from pathtrace.dataset.frame_set import FrameSet as FrameSet
    from pathtrace.scene.backend import select_backend as select_backend
    from pathtrace.scene.scene import Scene as Scene
    from splat.model.forest import Forest as Forest
    from splat.training.trainer import TrainingSettings as TrainingSettings

_NAMES = {
    "compose.base.errors": "UserError",
    "compose.camera.camera": "Camera",
    "compose.eye.display": "Display",
    "compose.eye.gaze": "Gaze",
    "compose.fovea.foveation": "FoveaMode",
    "hybrid.api.workflow": "capture evaluate load_forest load_frames load_scene plan prepare train",
    "hybrid.evaluation.evaluation_settings": "EvaluationSettings",
    "hybrid.preparation.stages": "PreparationSettings",
    "hybrid.render.frame": "Frame",
    "hybrid.render.frame_renderer": "Renderer",
    "hybrid.render.frame_settings": "FrameSettings",
    "hybrid.render.splat_renderer": "SplatRenderer",
    "hybrid.window.notebook": "show",
    "pathtrace.dataset.frame_set": "CaptureSettings FrameSet",
    "pathtrace.scene.backend": "select_backend",
    "pathtrace.scene.scene": "Scene",
    "splat.model.forest": "Forest",
    "splat.training.trainer": "TrainingSettings",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_MODULES)
__getattr__, __dir__ = names_on_demand(__name__, _MODULES)
