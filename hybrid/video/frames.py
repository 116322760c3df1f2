"""Frames of a film that is not finished, so that it goes on where it was interrupted."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.fovea.history import History
from hybrid.output.images import write_bytes
from hybrid.store.identity import require_same
from splat.io.tensors import load_tensors, save_tensors

# Seconds after which what the fovea remembers is written down once more.
_EVERY = 30.0


class FilmFrames:
    """The frames of a film that are rendered already, in a folder, with what the fovea remembers after them.

    Args:
        folder: where; made when there is something to keep.
        identity: of the film, as JSON has it.

    Attributes:
        milliseconds: per pass, of each frame that need not be rendered again.

    Raises:
        UserError: the folder is damaged, or holds another film.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]):
        self._folder, self._identity = folder, identity
        self._state = folder / "state.safetensors"
        self._kept = time.monotonic()
        self._memory: dict[str, torch.Tensor] = {}
        self.milliseconds: list[dict[str, float]] = []
        if self._state.is_file():
            self._memory, found = load_tensors(self._state)
            require_same(
                found.get("identity", {}),
                identity,
                f"{folder}: holds the beginning of a film",
                "delete it, or choose another --output",
            )
            self.milliseconds = found["milliseconds"]
            if not all(self._file(number).is_file() for number in range(len(self.milliseconds))):
                raise UserError(f"{folder}: frames are missing; delete it to begin anew")

    def history(self, camera: Camera) -> History | None:
        """What the fovea remembered after the last frame; None if there was nothing."""
        if not self._memory:
            return None
        return History.restored(camera, {name: t.numpy() for name, t in self._memory.items()})

    def add(
        self, picture: NDArray[np.uint8], milliseconds: dict[str, float], history: History | None
    ) -> None:
        """Keeps the next frame, (H, W, 3), and now and then what is remembered."""
        write_bytes(self._file(len(self.milliseconds)), picture)
        self.milliseconds.append(milliseconds)
        if time.monotonic() - self._kept > _EVERY:
            self.keep(history)

    def keep(self, history: History | None) -> None:
        """Writes down what is remembered after the last frame: a film goes on from there."""
        state = history.state() if history is not None else {}
        tensors = {name: torch.from_numpy(values) for name, values in state.items()}
        save_tensors(self._state, tensors, {"identity": self._identity, "milliseconds": self.milliseconds})
        self._kept = time.monotonic()

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """All of them, (H, W, 3) each."""
        for number in range(len(self.milliseconds)):
            with PillowImage.open(self._file(number)) as picture:
                yield np.asarray(picture)

    def remove(self) -> None:
        """The film is finished."""
        shutil.rmtree(self._folder)

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06}.png"
