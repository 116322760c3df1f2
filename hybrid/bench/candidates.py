"""All methods that a fovea may be made by, with the same number of samples."""

from __future__ import annotations

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from compose.fovea.region import Foveation
from compose.fovea.samples import Samples
from compose.image.colour import Image
from hybrid.frame.fovea import Fovea
from hybrid.frame.fusion import fusion_of
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import DEFAULTS
from hybrid.frame.underlay import Underlay
from hybrid.runtime.device import device_arrays
from pathtrace.base.denoise import denoise
from pathtrace.cache.cache import IrradianceCache
from pathtrace.scene.scene import Scene
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

# Radius in percent of the height of a disc that covers any frame.
_WHOLE = 1000.0


def whole_underlay(periphery: Periphery, camera: Camera) -> Underlay:
    """The finest layer over the whole frame."""
    return Underlay(
        camera,
        periphery.whole(camera, DEFAULTS).on_device(device_arrays()),
        periphery.enlargement(camera, DEFAULTS),
    )


class Candidates:
    """Foveas of one scene by all methods.

    Args:
        arrays: the rasterizer's array types.
        scene, forest: what is rendered.
        cache: irradiance of the scene as it is, for the cached integrator, which foveas use by default.

    Attributes:
        tracer: unbiased.
    """

    def __init__(self, arrays: Arrays, scene: Scene, forest: Forest, cache: IrradianceCache):
        self.tracer = Tracer(scene)
        self._periphery = Periphery(arrays, forest)
        cached = Tracer(scene, cache=cache)
        self._fused, self._statistical = Fovea(cached, fusion_of(forest)), Fovea(cached, None)
        self._unbiased = Fovea(self.tracer, None)

    def images(self, camera: Camera, spp: int, seed: int) -> dict[str, Image]:
        """(H, W, 3) radiance of a disc that covers the frame, by method.

        Returns:
            splat; raw; denoised; `denoised, path`, from samples of the unbiased integrator; mean, of splat
            and denoised; statistical, fused without a network; `fused, even`, with as many samples in every
            pixel; and fused, with adaptive samples as in frames.
        """
        underlay = whole_underlay(self._periphery, camera)
        region = Foveation(Gaze(), _WHOLE, _WHOLE).region(camera.width, camera.height)
        disc, splats = region.disc(device_arrays()), underlay.radiance.numpy()

        def traced(under: Underlay | None, fovea: Fovea) -> Samples:
            return fovea.trace(FoveaMode.FUSED, camera, disc, spp, seed, under)[1]

        def denoised(samples: Samples) -> Image:
            images = samples.radiance, samples.albedo, samples.normal
            radiance, albedo, normal = (disc.frame_image(image) for image in images)
            return denoise(radiance, albedo, normal)

        def fused(fovea: Fovea, samples: Samples) -> Image:
            made = fovea.image(FoveaMode.FUSED, disc, samples, underlay.radiance, underlay)
            return disc.frame_image(made.radiance)

        even = traced(None, self._fused)
        cleaned = denoised(even)
        return {
            "splat": splats,
            "raw": disc.frame_image(even.radiance),
            "denoised": cleaned,
            "denoised, path": denoised(traced(None, self._unbiased)),
            "mean": 0.5 * (cleaned + splats),
            "statistical": fused(self._statistical, even),
            "fused, even": fused(self._fused, even),
            "fused": fused(self._fused, traced(underlay, self._fused)),
        }
