"""What a folder of posed images holds, in whatever layout it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.posed.lens import Lens


@dataclass(frozen=True)
class PosedImage:
    """An image of a known camera and time.

    Attributes:
        camera: the view without the distortion of its lens, in the size of the image.
        lens: its distortion; None if there is none.
        file: the image, PNG in sRGB, with or without alpha.
        labels: an image of the same size that shows what moves; None if nobody says.
        time: that it shows, from 0 to 1.
        held_out: whether training must not see it.
    """

    camera: Camera
    lens: Lens | None
    file: Path
    labels: Path | None
    time: float
    held_out: bool


@dataclass(frozen=True)
class PosedFolder:
    """A folder of posed images.

    Attributes:
        folder: the folder itself.
        layout: name of its layout.
        scene_name: the folder's name, as far as it can be that of a scene.
        scene_hash: SHA-256 of the images and of all that is known of them.
        images: training and held-out ones, in the order of the folder.
        points: (M, 3) float64, some of what the images show, in world space; None if none are known.
        bounds: distances between which everything lies that they show; None if nobody says.
    """

    folder: Path
    layout: str
    scene_name: str
    scene_hash: str
    images: list[PosedImage]
    points: NDArray[np.float64] | None = None
    bounds: tuple[float, float] | None = None

    @property
    def digest(self) -> str:
        """What distinguishes it from other folders."""
        return self.scene_hash

    @property
    def training(self) -> list[PosedImage]:
        """Images to train on."""
        return [image for image in self.images if not image.held_out]

    @property
    def held_out(self) -> list[PosedImage]:
        """Images that training must not see."""
        return [image for image in self.images if image.held_out]

    @property
    def moves(self) -> bool:
        """Whether the training images show several times."""
        return len({image.time for image in self.training}) > 1
