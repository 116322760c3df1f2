"""Fits the odds of the fusion to foveas of several scenes, and tries it on each of them.

    python -m benchmarks.fit_fusion SCENE=FOREST ... [--views N] [--json FILE]

Foveas of frames of two sizes, in views that no forest was trained on, against unbiased references of 768
samples per pixel: of single frames, of views that stand still, and of walks. Reports rows of what the product
makes of them, PSNR in dB; the tables of compose/fusion/estimates.py, fitted to all scenes; and the gain over
the better one of splats and denoised samples, or over splats alone, in each scene, by odds that were fitted
without it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import torch
from torch import Tensor

import hybrid
from benchmarks import parser_of, report
from compose.camera.camera import Camera, camera_from_pose
from compose.fovea.disc import Disc
from compose.fusion.combination import Fusion
from compose.fusion.parents import Parents
from hybrid.render.disc_images import parents_of, smooth
from hybrid.render.fovea import worth_denoising
from hybrid.render.frame_renderer import Renderer
from pathtrace.region.neighbourhood import unseen_views
from pathtrace.scene.backend import select_backend
from pathtrace.trace.traced_images import denoise

_SIZES, _GAZES = ((480, 360), (320, 240)), ((0.5, 0.5), (0.35, 0.6), (0.65, 0.45))
_COUNTS = {"fresh": (1, 2, 4, 8, 16, 32, 64), "walk": (1, 2, 4), "still": (1, 2, 4)}
# Frames before the last one, and degrees that the camera turns between two of them.
_FRAMES, _TURN = 6, 0.6
# Of each half of a reference, in passes of so many samples per pixel; and the seed of the first one.
_PASSES, _SPP, _SEED = 3, 128, 9000
# Squared errors below this, of square roots of radiance, are not seen; the share of the better estimate's
# error below which less of it counts no more; by how much more of it counts what is worse than splats alone,
# which a frame in a hurry could show as well; and the penalty on squared odds.
_INVISIBLE, _LEAST, _WORSE, _PENALTY = 1e-5, 0.1, 3.0, 1e-3
_STEPS, _RATE, _BLOCK = 300, 0.1, 4
# Of the blocks, those that are fitted to.
_EVERY = 4


@dataclass(frozen=True)
class Fovea:
    """A fovea whose radiance is known up to noise; images (1, C, h, w), sides multiples of four.

    Attributes:
        scene, kind, spp: of its samples.
        denoises: whether the product denoises them.
        estimates: splats as they are, those that are mixed, relit ones, denoised samples; then what the
            product makes of them without denoised samples, and with them.
        seen: what the odds depend on without denoised samples and with them, (C, B) of blocks in the disc.
        target, noise, inside: roots of radiance, half the difference of those of two halves; 1 in the disc.
    """

    scene: str
    kind: str
    spp: int
    denoises: bool
    estimates: list[Tensor]
    seen: tuple[Tensor, Tensor]
    target: Tensor
    noise: Tensor
    inside: Tensor

    def products(self) -> Tensor:
        """(K, K, B) unbiased products of the errors of the estimates, means over the blocks of the disc."""
        errors = torch.cat([_root(image) - self.target for image in self.estimates])  # (K, 3, h, w)
        whole = _blocks(self.inside)[0, 0] > 1 - 1e-6
        products = torch.einsum("ichw,jchw->ijhw", errors, errors) - (self.noise**2).sum(1)
        return _blocks(products / 3)[:, :, whole]


def _root(radiance: Tensor) -> Tensor:
    return torch.sqrt(radiance.clamp(0, 1) + 1e-3)


def _blocks(images: Tensor) -> Tensor:
    return torch.nn.functional.avg_pool2d(images, _BLOCK)


def _cropped(image: Tensor) -> Tensor:
    height, width = (side - side % _BLOCK for side in image.shape[-2:])
    return image[..., :height, :width]


def foveas(name: str, file: Path, views: int) -> Iterator[Fovea]:
    """The foveas of some views of a scene."""
    forest = hybrid.load_forest(file)
    scene = hybrid.load_scene(name)
    renderer = Renderer(scene, forest)
    seen = (view for size in _SIZES for view in enumerate(unseen_views(renderer.scene, views, *size)))
    for number, view in seen:
        gaze = _GAZES[number % len(_GAZES)]
        settings = hybrid.FrameSettings(gaze=gaze, camera=view.camera, time=view.time)
        truth = _truth(renderer, settings)
        for kind, counts in _COUNTS.items():
            for spp in counts:
                yield _fovea(scene.name, kind, replace(settings, spp=spp), renderer, truth)


def _truth(renderer: Renderer, settings: hybrid.FrameSettings) -> tuple[Tensor, Tensor, Tensor]:
    """Target, noise and the pixels inside, as in Fovea."""
    settings = replace(settings, spp=_SPP, fovea="denoised", integrator="path")
    frame = renderer.frame(settings, _SEED)
    disc, maker, halves = frame.fovea.disc, renderer.fovea_of(settings), []
    for half in range(2):
        passes = []
        for number in range(_PASSES):
            seed = _SEED + 1 + _PASSES * half + number
            _, samples = maker.trace(frame.settings.fovea, frame.camera, disc, _SPP, seed, None, True)
            passes.append(_image(disc, samples.radiance))
        halves.append(torch.stack(passes).mean(0))
    inside = _image(disc, [dr.full(type(disc.weights), 1, disc.count)] * 3)
    features = [_image(disc, of) for of in (frame.fovea.samples.albedo, frame.fovea.samples.normal)]
    noisy = torch.where(inside > 0, torch.stack(halves).mean(0), _image(disc, frame.fovea.denoised or []))
    planes = [image[0].permute(1, 2, 0).contiguous().numpy() for image in (noisy, *features)]
    base = torch.from_numpy(denoise(planes[0], planes[1], planes[2])).permute(2, 0, 1)[None].clamp(min=0)
    # Linearized where the halves are nearly right, so that their noise stays unbiased.
    slope = torch.where(base < 1, 0.5 / _root(base), 0.0)
    one, other = (
        _cropped(_root(base) + (slope * inside * (half - base)).clamp(-0.5, 0.5)) for half in halves
    )
    return (one + other) / 2, (one - other) / 2, _cropped(inside[:, :1])


def _image(disc: Disc, channels: Sequence[Any]) -> Tensor:
    """(1, 3, h, w) of a disc's channels, 0 outside."""
    images = [np.array(image).reshape(disc.shape) for image in disc.images(channels, [0.0] * 3)]
    return torch.from_numpy(np.stack(images))[None]


def _fovea(
    scene: str,
    kind: str,
    settings: hybrid.FrameSettings,
    fresh: Renderer,
    truth: tuple[Tensor, Tensor, Tensor],
) -> Fovea:
    given = _last_of(kind, settings, fresh)
    height, width = (side - side % _BLOCK for side in given.shape)
    images = {name: image[:height, :width] for name, image in given.images().items()}
    parents = Parents.of_images(given.arrays, images, given.expected)
    pixels = dr.arange(parents.arrays.plain.UInt, height * width)

    def planes(channels: Sequence[Any], shape: tuple[int, int] = (height, width)) -> Tensor:
        """(1, C, H, W) of channels: their first numbers, or their only one everywhere."""
        return torch.from_numpy(np.stack([np.resize(np.array(of), shape) for of in channels]))[None]

    whole = _blocks(truth[2])[0, 0] > 1 - 1e-6
    candidates, seen, made = [], [], []
    for of in (replace(parents, denoised=None), parents):
        fusion = Fusion(of)
        ratio = smooth(fusion.ratio)
        found, channels = fusion.candidates(ratio)
        candidates = [planes(image) for image in found]
        seen.append(planes(channels, (height // _BLOCK, width // _BLOCK))[0][:, whole])
        made.append(planes(fusion.fused(ratio, pixels).radiance))
    denoises = worth_denoising(float(images["count"].mean()), parents.expected)
    splat = torch.from_numpy(np.moveaxis(images["splat"], 2, 0).copy())[None]
    estimates = [splat, *candidates, made[0], made[denoises]]
    return Fovea(scene, kind, settings.spp, denoises, estimates, (seen[0], seen[1]), *truth)


def _last_of(kind: str, settings: hybrid.FrameSettings, fresh: Renderer) -> Parents:
    """The parents of a single frame, or of the last one of several."""
    renderer = fresh
    assert settings.camera is not None
    if kind != "fresh":
        renderer = Renderer(fresh.scene, fresh.periphery.forest, history=True)
        for number in range(_FRAMES, 0, -1):
            camera = settings.camera if kind == "still" else _turned(settings.camera, number * _TURN)
            renderer.frame(replace(settings, camera=camera), number)
    frame = renderer.frame(settings, 100 + settings.spp)
    assert frame.underlay is not None
    return parents_of(frame.fovea.disc, frame.fovea.samples, frame.underlay)


def _turned(camera: Camera, degrees: float) -> Camera:
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ [[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]]
    return camera_from_pose(pose, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


@dataclass(frozen=True)
class Examples:
    """What odds are fitted to: evidence (C, B), products (K, K, B) and the disc (B,) of all blocks."""

    seen: Tensor
    products: Tensor
    disc: Tensor
    better: Tensor  # (discs,) error of splats, or of denoised samples if that is less

    @staticmethod
    def of(found: Sequence[tuple[Fovea, Tensor]], with_denoised: bool) -> Examples:
        """Of foveas and their products."""
        used, parents = ([1, 2, 3], [0, 3]) if with_denoised else ([1, 2], [0])
        found = [one for one in found if one[0].denoises or not with_denoised]
        alone = [products.mean(2).diagonal()[parents].min() for _, products in found]
        sizes = torch.tensor([products.shape[2] for _, products in found])
        return Examples(
            torch.cat([fovea.seen[with_denoised] for fovea, _ in found], 1),
            torch.cat([products[used][:, used] for _, products in found], 2),
            torch.repeat_interleave(torch.arange(len(found)), sizes),
            torch.stack(alone).clamp(min=_INVISIBLE),
        )

    def errors(self, odds: Tensor) -> Tensor:
        """(discs,) squared errors by odds (K - 1, C)."""
        logits = odds @ self.seen
        weights = torch.softmax(torch.cat([torch.zeros_like(logits[:1]), logits]), 0)
        errors = torch.einsum("kb,klb,lb->b", weights, self.products, weights)
        sums = torch.zeros(len(self.better)).index_add(0, self.disc, errors)
        return sums / torch.bincount(self.disc, minlength=len(self.better))

    def fitted(self) -> Tensor:
        """(K - 1, C) odds that make the mean logarithm of the errors small."""
        mean, deviation = self.seen.mean(1), self.seen.std(1).clamp(min=1e-3)
        mean[0], deviation[0] = 0, 1  # the constant channel
        some = ((self.seen - mean[:, None]) / deviation[:, None])[:, ::_EVERY]
        scaled = replace(self, seen=some, products=self.products[..., ::_EVERY], disc=self.disc[::_EVERY])
        odds = torch.zeros(len(self.products) - 1, len(mean), requires_grad=True)
        optimizer = torch.optim.Adam([odds], _RATE)
        for step in range(_STEPS):
            if step == _STEPS * 2 // 3:
                optimizer.param_groups[0]["lr"] = _RATE / 5
            share = (scaled.errors(odds) / self.better).clamp(min=0)
            loss = torch.log(_LEAST + share).mean() + _PENALTY * (odds**2).sum()
            if len(odds) == 1:
                loss = loss + _WORSE * torch.relu(share - 1).mean()
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        found = odds.detach() / deviation
        found[:, 0] -= (found[:, 1:] * mean[1:]).sum(1)
        return found


def _gains(found: Sequence[tuple[Fovea, Tensor]]) -> dict[str, dict[str, float]]:
    """Mean gain in dB in each scene by odds that were fitted to all others, if there are any."""
    gains: dict[str, dict[str, float]] = {}
    for scene in sorted({fovea.scene for fovea, _ in found}):
        inside = [one for one in found if one[0].scene == scene]
        others = [one for one in found if one[0].scene != scene]
        gains[scene] = {}
        for name, with_denoised in (("quick", False), ("full", True)) if others else ():
            odds, tried = Examples.of(others, with_denoised).fitted(), Examples.of(inside, with_denoised)
            ratio = tried.better / tried.errors(odds).clamp(min=_INVISIBLE)
            gains[scene][name] = float((10 * torch.log10(ratio)).mean())
    return gains


def _rows(found: Sequence[tuple[Fovea, Tensor]]) -> list[dict[str, Any]]:
    """PSNR in dB of roots of radiance, mean over the views of each scene, kind and number of samples."""
    names = "splat", "sharpened", "relit", "denoised", "quick", "fused"
    of_key: dict[tuple[str, str, int], list[Tensor]] = {}
    for fovea, products in found:
        errors = products.mean(2).diagonal().clamp(min=1e-6)
        of_key.setdefault((fovea.scene, fovea.kind, fovea.spp), []).append(-10 * torch.log10(errors))
    return [
        {"scene": scene, "kind": kind, "spp": spp}
        | dict(zip(names, torch.stack(psnr).mean(0).tolist(), strict=True))
        for (scene, kind, spp), psnr in of_key.items()
    ]


def main() -> None:
    """The command line."""
    parser = parser_of(__doc__)
    parser.add_argument("scenes", nargs="+", metavar="SCENE=FOREST")
    parser.add_argument("--views", type=int, default=3)
    options = parser.parse_args()
    select_backend("llvm")
    found = []
    for pair in options.scenes:
        scene, _, forest = pair.partition("=")
        for fovea in foveas(scene, Path(forest), options.views):
            found.append((replace(fovea, estimates=[]), fovea.products()))
    odds = {n: Examples.of(found, d).fitted().tolist() for n, d in (("QUICK_ODDS", False), ("ODDS", True))}
    report({"odds": odds, "gains": _gains(found), "foveas": _rows(found)}, options.json)


if __name__ == "__main__":
    main()
