"""Messages between server and client, version 2: docs/remote.md describes them.

Whatever does not fit is a ValueError of one line, at both ends.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, claimed_scene
from compose.base.files import parse_json
from compose.camera.camera import Camera
from compose.eye.acuity import acuity_model_named
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import MOST_LEVEL
from splat.model.points import Bits, Ints

# What a viewer sees, where they look, and on what.
View: TypeAlias = tuple[Camera, Gaze, Display]
VERSION = 2
# Of WebSockets: another version is refused before anything is sent.
SUBPROTOCOL = f"hybrid-remote-{VERSION}"
FOREST_WANTED, VIEW, FOREST_PART, MASK = 1, 2, 3, 4
_VIEW = struct.Struct("<BII16dHH4d2dHH2d")
_MASK = struct.Struct("<BIIIf")
# Longest message of a client, and of a server: a part of the forest, or a mask of 100 million nodes.
MOST_FROM_CLIENT, MOST_FROM_SERVER = 512, 1 << 24
# Sides of frames in pixels, larger than any headset's.
_MOST_SIDE = 8192
# Bytes of a forest: 100 million Gaussians would take ten times as many.
MOST_FOREST = 1 << 30
# Bytes of a welcome.
_MOST_WELCOME = 1 << 14


@dataclass(frozen=True)
class ViewMessage:
    """What the viewer sees and where they look.

    Attributes:
        sequence: larger than that of the view before, under 2^32.
        held: number of the newest mask that the client has; 0 for none.
        camera, gaze, display: as in `FrameSettings`; sides of both are at most 8192 pixels.
    """

    sequence: int
    held: int
    camera: Camera
    gaze: Gaze
    display: Display

    @property
    def view(self) -> View:
        """What is seen: camera, gaze and display."""
        return self.camera, self.gaze, self.display

    def packed(self) -> bytes:
        """The message."""
        camera, display = self.camera, self.display
        return _VIEW.pack(
            *(VIEW, self.sequence, self.held, *camera.world_to_camera.flat, camera.width, camera.height),
            *(camera.fx, camera.fy, camera.cx, camera.cy, self.gaze.x, self.gaze.y),
            *(display.width, display.height, display.fov, display.luminance),
        )

    @staticmethod
    def unpacked(message: bytes) -> ViewMessage:
        """Reads a message; ValueError if anything in it is out of range."""
        if len(message) != _VIEW.size:
            raise ValueError(f"a view of {len(message)} bytes; must have {_VIEW.size}")
        _, sequence, held, *rest = _VIEW.unpack(message)
        pose, (width, height, *lens), gaze, shown = rest[:16], rest[16:22], rest[22:24], rest[24:]
        if max(width, height, *shown[:2]) > _MOST_SIDE:
            raise ValueError(f"a view of {width} x {height} pixels; sides must be at most {_MOST_SIDE}")
        try:
            camera = Camera(np.array(pose).reshape(4, 4), width, height, *lens)
            return ViewMessage(sequence, held, camera, Gaze(*gaze), Display(*shown))
        except UserError as error:
            raise ValueError(str(error)) from error


@dataclass(frozen=True)
class MaskMessage:
    """The cut for a view.

    Attributes:
        number: of the mask, from 1 on, each larger than the one before.
        base: number of the mask that the content is against; 0 for one in which nothing is split.
        sequence: of the view.
        level: continuous level of detail that the cut was made for.
        content: of the mask.
    """

    number: int
    base: int
    sequence: int
    level: float
    content: bytes

    def packed(self) -> bytes:
        """The message."""
        return _MASK.pack(MASK, self.number, self.base, self.sequence, self.level) + self.content

    @staticmethod
    def unpacked(message: bytes) -> MaskMessage:
        """Reads a message; ValueError if anything but its content is out of range."""
        if len(message) < _MASK.size:
            raise ValueError(f"a mask of {len(message)} bytes")
        _, number, base, sequence, level = _MASK.unpack_from(message)
        if not 0 < level <= MOST_LEVEL:
            raise ValueError(f"a mask for level {level:g}; must be over 0 and at most {MOST_LEVEL:g}")
        if base >= number:
            raise ValueError(f"mask {number} against {base}")
        return MaskMessage(number, base, sequence, level, message[_MASK.size :])


@dataclass(frozen=True)
class Welcome:
    """The server's first message, in JSON.

    Attributes:
        scene: name.
        camera: the scene's own, or one that the forest was trained on.
        distance: median distance to what that camera sees, in units of the scene.
        forest: SHA-256 of the forest's file.
        bytes, packed: of that file, and of what is sent of it, deflated.
        acuity_model: name of what decides which detail is resolved.
        rate: views per second that the server takes.
    """

    scene: str
    camera: Camera
    distance: float
    forest: str
    bytes: int
    packed: int
    acuity_model: str
    rate: float

    def text(self) -> str:
        """The message."""
        camera = vars(self.camera) | {"world_to_camera": self.camera.world_to_camera.tolist()}
        return json.dumps(vars(self) | {"camera": camera, "version": VERSION})

    @staticmethod
    def of_text(message: str) -> Welcome:
        """Reads a message; ValueError if anything in it is out of range."""
        if len(message) > _MOST_WELCOME:
            raise ValueError(f"a welcome of {len(message)} characters")
        try:
            entry: dict[str, Any] = parse_json(message)
            if entry.pop("version") != VERSION:
                raise ValueError(f"a server of another version than {VERSION}")
            camera = entry.pop("camera")
            pose = np.array(camera.pop("world_to_camera"), dtype=np.float64)
            found = Welcome(camera=Camera(pose, **camera), **entry)
            acuity_model_named(found.acuity_model)
            # Both become parts of files' names.
            claimed_scene(found.scene, found.forest)
            if not isinstance(found.bytes, int) or not isinstance(found.packed, int):
                raise TypeError("sizes must be whole numbers")
            if not (found.distance > 0 and found.rate > 0):
                raise ValueError("a welcome whose distance or rate is not over 0")
        except (TypeError, KeyError, AttributeError, UserError) as error:
            raise ValueError(f"a welcome that says something else ({error})") from error
        if len(found.forest) != 64:
            raise ValueError("a welcome whose hash is none")
        if not 0 < found.packed <= 2 * MOST_FOREST or not 0 < found.bytes <= MOST_FOREST:
            raise ValueError(f"a forest of {found.bytes} bytes; at most {MOST_FOREST} are taken")
        return found


# Bits of a gap in each of its bytes, and bytes that a gap takes at most: over 200 million nodes.
_BITS, _MOST_BYTES = 7, 4
_CONTINUED = 1 << _BITS
# Of a walk through a room of 108,500 Gaussians, against masks an eighth of a second older: 3.3 kB; at level 6
# 3.1 kB, in twice the time; the bits themselves 3.7 kB, and gaps that are not deflated 5.6 kB.
_ZLIB_LEVEL = 1


def encoded_mask(split: Bits, base: Bits) -> bytes:
    """What turns a base (M,) into a mask (M,)."""
    gaps = np.diff(np.flatnonzero(split ^ base), prepend=-1) - 1
    return zlib.compress(_bytes_of(gaps).tobytes(), _ZLIB_LEVEL)


def decoded_mask(content: bytes, base: Bits) -> Bits:
    """The mask (M,) that was encoded against a base (M,), in no more memory than that, whatever the content.

    Raises:
        ValueError: the content does not fit the base.
    """
    # No two bytes belong to gaps of less than 128 nodes in total.
    most = len(base) + _MOST_BYTES
    inflating = zlib.decompressobj()
    try:
        found = inflating.decompress(content, most)
    except zlib.error as error:
        raise ValueError(f"a mask that cannot be inflated ({error})") from error
    if not inflating.eof or inflating.unused_data:
        raise ValueError("a mask that does not end where it should")
    changed = np.cumsum(_gaps_of(np.frombuffer(found, np.uint8)) + 1) - 1
    if len(changed) and changed[-1] >= len(base):
        raise ValueError(f"a mask of node {changed[-1]}; there are {len(base)}")
    split = base.copy()
    split[changed] ^= True
    return split


def _bytes_of(gaps: Ints) -> NDArray[np.uint8]:
    """Numbers in groups of seven bits, the lowest first; all but the last of each have the top bit set."""
    size = np.ones(len(gaps), np.int64)
    for k in range(1, _MOST_BYTES):
        size += gaps >= 1 << _BITS * k
    first = np.cumsum(size) - size
    found = np.zeros(int(size.sum()), np.uint8)
    for k in range(_MOST_BYTES):
        longer = size > k
        more = np.where(size[longer] > k + 1, _CONTINUED, 0)
        found[first[longer] + k] = gaps[longer] >> _BITS * k & _CONTINUED - 1 | more
    return found


def _gaps_of(content: NDArray[np.uint8]) -> Ints:
    if not len(content):
        return np.zeros(0, np.int64)
    last = np.flatnonzero(content < _CONTINUED)
    first = np.append(0, last[:-1] + 1)
    if not len(last) or last[-1] != len(content) - 1 or (last - first).max() >= _MOST_BYTES:
        raise ValueError("a mask with a number that does not end")
    place = np.arange(len(content)) - np.repeat(first, last - first + 1)
    parts = (content.astype(np.int64) & _CONTINUED - 1) << _BITS * place
    return np.add.reduceat(parts, first)
