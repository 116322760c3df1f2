"""A headset by OpenXR: poses, the gaze where eyes are tracked, and images by OpenGL without a window.

It requires the package pyopenxr, and a runtime with XR_MNDX_egl_enable, such as Monado.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError, one_line
from compose.camera.camera import Array
from hybrid.window.headset import Eye, HeadsetFrame

# Read when OpenGL is loaded.
os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import xr
from OpenGL import GL
from xr.utils.gl import ContextObject
from xr.utils.gl.egl_util import EGLOffscreenContextProvider

_OPENGL, _EGL, _GAZE = "XR_KHR_opengl_enable", "XR_MNDX_egl_enable", "XR_EXT_eye_gaze_interaction"
_GAZE_PROFILE = "/interaction_profiles/ext/eye_gaze_interaction"
_GAZE_POSE = "/user/eyes_ext/input/gaze_ext/pose"


class OpenXRHeadset:
    """A session of the OpenXR runtime of this machine; a context manager.

    UserError of one line, when it is entered, if the runtime, the headset or OpenGL is missing.
    """

    def __enter__(self) -> OpenXRHeadset:
        self._stack = ExitStack()
        try:
            known = {one.extension_name.decode() for one in xr.enumerate_instance_extension_properties()}
            if missing := [name for name in (_OPENGL, _EGL) if name not in known]:
                raise UserError(f"--xr: the OpenXR runtime lacks {' and '.join(missing)}")
            wanted = [_OPENGL, _EGL, *([_GAZE] if _GAZE in known else [])]
            context = ContextObject(
                EGLOffscreenContextProvider(),
                instance_create_info=xr.InstanceCreateInfo(enabled_extension_names=wanted),
                # A second session must not get the default one, which the first has filled in.
                session_create_info=xr.SessionCreateInfo(),
                # Begins where the head is, upright.
                reference_space_create_info=xr.ReferenceSpaceCreateInfo(xr.ReferenceSpaceType.LOCAL),
            )
            self._context = self._stack.enter_context(context)
            self._target = _ImageTarget()
            self._gaze = _GazeAction(context) if _GAZE in known else None
        except xr.exception.XrException as error:
            self._stack.close()
            raise UserError(f"--xr: {one_line(error)}") from error
        except (RuntimeError, GL.error.Error) as error:
            self._stack.close()
            raise UserError(f"--xr: OpenGL cannot be used here ({one_line(error)})") from error
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def frames(self) -> Iterator[HeadsetFrame]:
        """The frames that the runtime wants to be rendered, until it ends the session."""
        context = self._context
        for state in context.frame_loop():
            if not state.should_render:
                continue
            place = xr.ViewLocateInfo(
                view_configuration_type=context.view_configuration_type,
                display_time=state.predicted_display_time,
                space=context.space,
            )
            located, views = xr.locate_views(session=context.session, view_locate_info=place)
            if not located.view_state_flags & xr.VIEW_STATE_ORIENTATION_VALID_BIT:
                continue
            gaze = None if self._gaze is None else self._gaze.at(state.predicted_display_time)
            yield HeadsetFrame([_eye(view) for view in views], gaze, partial(self._show, state))

    def _show(self, state: xr.FrameState, images: Sequence[NDArray[np.uint8]]) -> None:
        # Locates the views once more, for the same time, and binds the image of one after the other.
        for number, _ in enumerate(self._context.view_loop(state)):
            swapchain = self._context.swapchains[number]
            self._target.draw(images[number], swapchain.width, swapchain.height)


class _ImageTarget:
    """Draws images, scaled, to whatever is bound."""

    def __init__(self) -> None:
        self._texture, self._source = GL.glGenTextures(1), GL.glGenFramebuffers(1)

    def draw(self, image: NDArray[np.uint8], width: int, height: int) -> None:
        """Draws an (H, W, 3) sRGB image to a framebuffer of a size in pixels, however that is encoded."""
        target = GL.glGetIntegerv(GL.GL_DRAW_FRAMEBUFFER_BINDING)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texture)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        rows, columns = image.shape[:2]
        content = np.ascontiguousarray(image)
        GL.glTexImage2D(
            *(GL.GL_TEXTURE_2D, 0, GL.GL_SRGB8_ALPHA8, columns, rows),
            *(0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, content),
        )
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._source)
        attached = GL.GL_READ_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_TEXTURE_2D
        GL.glFramebufferTexture2D(*attached, self._texture, 0)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, target)
        GL.glEnable(GL.GL_FRAMEBUFFER_SRGB)
        # Rows count from the top in images, from the bottom in OpenGL.
        corners = 0, 0, columns, rows, 0, height, width, 0
        GL.glBlitFramebuffer(*corners, GL.GL_COLOR_BUFFER_BIT, GL.GL_LINEAR)


class _GazeAction:
    """Where the eyes look, as the extension for eye gaze tells it."""

    def __init__(self, context: ContextObject):
        self._context = context
        pose, actions = xr.ActionType.POSE_INPUT, context.default_action_set
        info = xr.ActionCreateInfo(action_type=pose, action_name="gaze", localized_action_name="Gaze")
        self._action = xr.create_action(action_set=actions, create_info=info)
        path = xr.string_to_path(context.instance, _GAZE_POSE)
        binding = xr.ActionSuggestedBinding(action=self._action, binding=path)
        suggested = xr.InteractionProfileSuggestedBinding(
            interaction_profile=xr.string_to_path(context.instance, _GAZE_PROFILE),
            count_suggested_bindings=1,
            suggested_bindings=(xr.ActionSuggestedBinding * 1)(binding),
        )
        xr.suggest_interaction_profile_bindings(context.instance, suggested)
        self._space = xr.create_action_space(context.session, xr.ActionSpaceCreateInfo(action=self._action))

    def at(self, moment: int) -> Array | None:
        """(4, 4) gaze to room at a time of the runtime; None if nothing tracks the eyes now."""
        context = self._context
        active = (xr.ActiveActionSet * 1)(xr.ActiveActionSet(action_set=context.default_action_set))
        try:
            info = xr.ActionsSyncInfo(count_active_action_sets=1, active_action_sets=active)
            xr.sync_actions(context.session, info)
        except xr.exception.SessionNotFocused:
            return None
        state = xr.get_action_state_pose(context.session, xr.ActionStateGetInfo(action=self._action))
        if not state.is_active:
            return None
        found = xr.locate_space(self._space, context.space, moment)
        valid = found.location_flags & xr.SPACE_LOCATION_ORIENTATION_VALID_BIT
        return _matrix(found.pose) if valid else None


def _eye(view: xr.View) -> Eye:
    fov = view.fov
    angles = fov.angle_left, fov.angle_right, fov.angle_down, fov.angle_up
    return Eye(_matrix(view.pose), *(float(np.tan(angle)) for angle in angles))


def _matrix(pose: xr.Posef) -> Array:
    """(4, 4) of a position and a quaternion."""
    turn, place = pose.orientation, pose.position
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    found[:3, 3] = place.x, place.y, place.z
    return found
