"""Frames of an unfinished video, from which it resumes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.errors import UserError
from hybrid.output.images import write_srgb
from hybrid.store.identity import require_same
from splat.io.tensors import load_tensors, save_tensors

# Frames of a video at most: their files are numbered by six digits.
MOST_FRAMES = 999_999
# Seconds between two saves of the fovea's history.
_EVERY = 30.0
State = dict[str, NDArray[np.generic]]


def frame_count(seconds: float, fps: int) -> int:
    """Number of frames of a video, at least 1; UserError if there would be too many."""
    if seconds * fps > MOST_FRAMES:
        raise UserError(f"{seconds:g} s at {fps} frames per second: must be {MOST_FRAMES} frames at most")
    return max(1, round(seconds * fps))


class VideoFrames:
    """The rendered frames of a video, in a folder, and the fovea's history after the last of them.

    Args:
        folder: for frames and history; created with the first frame.
        identity: everything that the frames depend on, in types that JSON has.

    Attributes:
        milliseconds: per pass, of each rendered frame.

    Raises:
        UserError: the folder is damaged, or holds another video.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]):
        self._folder, self._identity = folder, identity
        self._state = folder / "state.safetensors"
        self._saved = time.monotonic()
        self._history: dict[str, torch.Tensor] = {}
        self.milliseconds: list[dict[str, float]] = []
        if self._state.is_file():
            again = "delete the folder to start again"
            self._history, found = load_tensors(self._state, again)
            require_same(
                found.get("identity", {}),
                identity,
                f"{folder}: holds the beginning of a video",
                "delete it, or choose another output file",
            )
            self.milliseconds = list(found.get("milliseconds") or [])
            for number in range(len(self.milliseconds)):
                self._check(self._file(number))

    def history(self) -> State:
        """The fovea's history after the last frame; empty if there is none."""
        return {name: tensor.numpy() for name, tensor in self._history.items()}

    def add(
        self, image: NDArray[np.uint8], milliseconds: dict[str, float], history: Callable[[], State]
    ) -> None:
        """Stores the next frame, (H, W, 3) in sRGB, and the history once in a while.

        Args:
            image: the frame.
            milliseconds: per pass.
            history: called for the fovea's history if it is to be stored.
        """
        write_srgb(self._file(len(self.milliseconds)), image)
        self.milliseconds.append(milliseconds)
        if time.monotonic() - self._saved > _EVERY:
            self.keep(history())

    def keep(self, history: State) -> None:
        """Stores the history after the last frame; the video resumes from there."""
        tensors = {name: torch.from_numpy(values) for name, values in history.items()}
        save_tensors(self._state, tensors, {"identity": self._identity, "milliseconds": self.milliseconds})
        self._saved = time.monotonic()

    def images(self) -> Iterator[NDArray[np.uint8]]:
        """All frames, (H, W, 3) in sRGB each."""
        for number in range(len(self.milliseconds)):
            with PillowImage.open(self._file(number)) as image:
                yield np.asarray(image)

    def remove(self) -> None:
        """Deletes the folder, once the video is complete."""
        shutil.rmtree(self._folder)

    def _check(self, file: Path) -> None:
        """Refuses to resume from a frame that is missing or damaged: its history is not known any more."""
        if not file.is_file():
            raise UserError(f"{self._folder}: frames are missing; delete it to start again")
        try:
            with PillowImage.open(file) as image:
                # Reads all of it, by way of the checksums of PNG.
                image.verify()
        except (OSError, SyntaxError, ValueError) as error:
            raise UserError(f"{file}: is damaged ({error}); delete {self._folder} to start again") from error

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06}.png"
