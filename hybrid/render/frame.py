"""A rendered frame, its parts, and its AOVs: the named images of its EXR file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.eye.gaze import eccentricity
from compose.fovea.cells import CellRegion
from compose.fovea.foveation import FoveaRegion
from compose.fusion.parents import PARENTS
from compose.image.colour import Image
from compose.image.device_image import DeviceImage
from hybrid.render.disc_images import Underlay
from hybrid.render.fovea import FoveaImage
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.hole_filling import Fill
from hybrid.render.image_files import write_exr, write_png

if TYPE_CHECKING:
    from drjit.auto.ad import Float


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame and its parts, in the memory of the device that made it.

    Attributes:
        image: linear radiance, the frame itself; its `tensor` is for kernels, NumPy and torch.
        settings: how it was made, as resolved for its camera.
        behind: three Floats (D,), what the periphery shows in the disc's pixels.
        detail: the detail that the viewer resolves in each part of the frame.
        nodes_drawn: Gaussians drawn in the periphery, counted once per layer image.
        fovea: the disc and what it was made from; its `disc` has the weights of the blend and, of a raw
            fovea, the pixels with samples only.
        region: the disc, or the cells that are traced in its place.
        milliseconds: per pass (region, detail, splat, fill, trace, fovea, blend), and in total.
        underlay: the splats under the disc, if fused.
        fill: what was path-traced because the forest does not know it; None if it knows all of the frame.
        more: by name the AOVs that the settings ask for, (H, W, 3) or (H, W): splat, the finest layer over
            the whole frame, and depth, of the first hit along the view axis, inf where nothing is hit.
    """

    image: DeviceImage
    settings: FrameSettings
    camera: Camera
    behind: list[Float]
    detail: DetailMap
    nodes_drawn: int
    fovea: FoveaImage
    region: FoveaRegion | CellRegion
    milliseconds: dict[str, float]
    underlay: Underlay | None = None
    fill: Fill | None = None
    more: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    @property
    def composite(self) -> Image:
        """(H, W, 3) linear radiance in host memory; on the CPU, that is where it is."""
        return self.image.numpy()

    @property
    def splats(self) -> DeviceImage:
        """The periphery, and what was filled, made of the composite; black in tiles that the fovea hides."""
        disc = self.fovea.disc
        return self.image.packed().changed(disc.pixels, self.behind) if disc.count else self.image

    @property
    def periphery(self) -> Image:
        """(H, W, 3) `splats` in host memory; on the CPU, that is where it is."""
        return self.splats.numpy()

    @property
    def filled(self) -> float:
        """Share of the frame, 0 to 1, that was path-traced because the forest does not know it."""
        return 0.0 if self.fill is None else self.fill.share

    def of_disc(self, channels: list[Float]) -> NDArray[np.float32]:
        """(H, W, C) host image of channels, C Floats (D,), of the disc's pixels; black elsewhere."""
        return self.fovea.disc.frame_image(channels)

    def weight_image(self) -> NDArray[np.float32]:
        """(H, W) weight of the fovea; the weight of the splats is one minus it."""
        return self.of_disc([self.fovea.disc.weights])[..., 0]

    def aovs(self) -> dict[str, NDArray[np.float32]]:
        """The images that the frame consists of, (H, W, 3) or (H, W) by name: the layers of its EXR file.

        Returns:
            composite (also without a name); unless the disc is empty, fovea as it was blended, path-traced,
            the mean of the samples, variance, of that mean (inf where there is only one sample), weight of
            the fovea, denoised, unless raw, and, if fused, the share of each parent (fusion.traced,
            fusion.denoised, fusion.relit, fusion.splat); eccentricity in degrees on the display; level (1 to
            L); rate (log2 of pixels per sample along each axis); coverage, what the forest knows: 1 where
            nothing was filled; and those that the settings ask for.
        """
        detail, viewer = self.detail, self.settings.display.viewer(self.camera.width, self.camera.height)
        coverage = np.ones((self.camera.height, self.camera.width), dtype=np.float32)
        if self.fill is not None:
            coverage -= self.fill.disc.frame_image([self.fill.disc.weights])[..., 0]
        composite = self.composite
        return {
            "": composite,
            "composite": composite,
            **(self._aovs_of_disc() if self.fovea.disc.count else {}),
            "eccentricity": eccentricity(viewer, self.settings.gaze),
            "level": detail.per_pixel(detail.drawn_level),
            "rate": detail.per_pixel(detail.drawn_rate),
            **self.more,
            "coverage": coverage,
        }

    def _aovs_of_disc(self) -> dict[str, NDArray[np.float32]]:
        fovea = self.fovea
        found = {
            "fovea": self.of_disc(fovea.radiance),
            "path-traced": self.of_disc(fovea.samples.radiance),
            "variance": self.of_disc(fovea.samples.variance()),
            "weight": self.weight_image(),
        }
        if fovea.denoised is not None:
            found["denoised"] = self.of_disc(fovea.denoised)
        if fovea.weights is not None:
            shares = self.of_disc(fovea.weights)
            found |= {f"fusion.{name}": shares[..., i] for i, name in enumerate(PARENTS)}
        return found

    def save(self, path: Path | str) -> None:
        """Writes the frame: .exr with its AOVs in linear radiance, or .png with the composite in sRGB.

        The EXR file's header says how paths were traced (`integrator`), and whether the disc is `unbiased`;
        nothing of a frame without a disc.

        Raises:
            UserError: the file has another extension, or cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() == ".exr":
            facts = {}
            if self.fovea.disc.count:
                facts["integrator"] = self.settings.used_integrator.value
                facts["unbiased"] = str(self.settings.is_unbiased)
            write_exr(path, self.aovs(), facts)
        elif path.suffix.lower() == ".png":
            write_png(path, self.composite)
        else:
            raise UserError(f"{path}: must end in .exr or .png")
