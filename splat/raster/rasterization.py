"""`splat.rasterization`: Gaussians to images, with the arguments and results of gsplat's function."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from compose.base.arrays import Arrays
from splat.raster.blending import Compositing
from splat.raster.differentiable import arrays_of
from splat.raster.tiles import TileGrid
from splat.raster.torch_splats import (
    AT_ONCE,
    FlatSplats,
    Limits,
    Screen,
    blended,
    harmonic_colours,
    project,
    scaled_axes,
)

# As gsplat composites: alphas up to 0.999, and pixels end in front of what would make them opaque.
_RULES = Compositing(highest_alpha=0.999, ends_pixels=True)
_MODES = "RGB", "D", "ED", "RGB+D", "RGB+ED"
_HIGHEST_DEGREE = 3
# Arguments of gsplat that must have their defaults.
_REFUSED = {
    "distributed": False,
    "camera_model": "pinhole",
    "covars": None,
    "with_ut": False,
    "with_eval3d": False,
    "radial_coeffs": None,
    "tangential_coeffs": None,
    "thin_prism_coeffs": None,
    "ftheta_coeffs": None,
    "rolling_shutter": "GLOBAL",
    "viewmats_rs": None,
}
# Opacity that an expected depth is divided by at least.
_LEAST_OPACITY = 1e-10


def rasterization(  # noqa: PLR0913 the arguments of gsplat
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    viewmats: torch.Tensor,
    Ks: torch.Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: torch.Tensor | None = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    segmented: bool = False,
    **others: object,
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Renders Gaussians as gsplat's `rasterization` does (1.5), on a CPU or a GPU.

    A script written for gsplat runs with `from splat import rasterization`. Shapes, conventions, cameras,
    filter and compositing are gsplat's, which differ from those of `render`: parameters are not logarithms or
    logits, colours are taken as they are, not from sRGB to linear radiance.

        >>> import torch
        >>> from splat import rasterization
        >>> means = torch.tensor([[0.0, 0.0, 2.0], [0.2, 0.0, 3.0]], requires_grad=True)
        >>> colors, alphas, meta = rasterization(
        ...     means,
        ...     quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(2, 1),
        ...     scales=torch.full((2, 3), 0.1),
        ...     opacities=torch.tensor([0.5, 0.9]),
        ...     colors=torch.eye(3)[:2],
        ...     viewmats=torch.eye(4)[None],
        ...     Ks=torch.tensor([[[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]]]),
        ...     width=64,
        ...     height=48,
        ... )
        >>> colors.shape, alphas.shape
        (torch.Size([1, 48, 64, 3]), torch.Size([1, 48, 64, 1]))
        >>> meta["means2d"].retain_grad()
        >>> colors.mean().backward()
        >>> meta["means2d"].grad.shape
        torch.Size([2, 2])

    Torch differentiates both images by means, quats, scales, opacities, colors, viewmats, Ks, backgrounds and
    `meta["means2d"]`, once. Kernels compute in float32.

    Unlike in gsplat 1.5.3, gradients are dense with `sparse_grad`, too; `sh_degree` is 3 at most; `absgrad`
    takes three channels at most; `meta` has no lists of tiles.

    Args:
        means: (..., N, 3) centres. Dimensions in front are batches, the same for all tensors.
        quats: (..., N, 4) rotations, w first, of any length.
        scales: (..., N, 3) standard deviations.
        opacities: (..., N) in 0..1.
        colors: (..., N, D) or (..., C, N, D) any number of channels; with `sh_degree`, spherical harmonics
            (..., N, K, 3) or (..., C, N, K, 3), to which 0.5 is added.
        viewmats: (..., C, 4, 4) world to camera, x to the right, y down, z forward.
        Ks: (..., C, 3, 3) focal lengths and principal points in pixels.
        width: of the images in pixels.
        height: of the images in pixels.
        near_plane: least depth at which Gaussians are drawn.
        far_plane: greatest depth at which Gaussians are drawn.
        radius_clip: Gaussians that reach no more pixels from their centre than this are not drawn.
        eps2d: variance in px^2 of the filter that each Gaussian gets on the screen; 0 or more.
        sh_degree: 0 to 3, harmonics up to which count; None if `colors` are colours.
        packed: whether `meta` lists what is drawn, M pairs of camera and Gaussian, in place of all; the
            images are the same.
        tile_size: changes nothing here, and nor do `sparse_grad`, `channel_chunk` and `segmented`.
        backgrounds: (..., C, D) colours behind all Gaussians; depths have none. Black by default.
        render_mode: "RGB" colours; "D" sums of depths times weights; "ED" these over the opacity, expected
            depths; "RGB+D", "RGB+ED" both, depth last.
        sparse_grad: see `tile_size`.
        absgrad: whether backward writes `meta["means2d"].absgrad`, sums over pixels of the absolute values of
            their derivatives (Ye et al., AbsGS, 2024).
        rasterize_mode: "classic", or "antialiased": opacities make up for what the filter adds.
        channel_chunk: see `tile_size`.
        segmented: see `tile_size`.
        others: `camera_model`, `covars`, `distributed`, `with_ut`, `with_eval3d`, `rolling_shutter`,
            `viewmats_rs` and the coefficients of distortion, at their defaults only.

    Returns:
        Images (..., C, height, width, X) of D channels, of the depth, or of both; opacities
        (..., C, height, width, 1); and a dict with `means2d` (..., C, N, 2) in pixels, `radii`
        (..., C, N, 2) int32, half the box in which each Gaussian shows, 0 for those that are not drawn,
        `depths` (..., C, N), `conics` (..., C, N, 3), `opacities` (..., C, N), `batch_ids`, `camera_ids` and
        `gaussian_ids`, which are None, `width`, `height`, `tile_size`, `n_batches` and `n_cameras`. If
        packed, (M, ...) instead of (..., C, N, ...), and the ids are (M,).

    Raises:
        ValueError: a shape, a device, or a value is none of these; the line names the argument.
        NotImplementedError: an argument of gsplat has a value that is not supported; the line names it.
        TypeError: gsplat has no such argument.
        UserError: the tensors are on the CPU, and there is no LLVM that Dr.Jit can use.
    """
    _refuse(others)
    _check_choices(render_mode, rasterize_mode, eps2d, width, height)
    _check_shapes(means, viewmats, quats=quats, scales=scales, opacities=opacities, Ks=Ks)
    shape = torch.Size([*viewmats.shape[:-2], means.shape[-2]])
    # Depths have no background.
    backgrounds = backgrounds if "RGB" in render_mode else None
    _check_colors(colors, sh_degree, shape, backgrounds)
    behind = [] if backgrounds is None else [backgrounds]
    arrays = arrays_of("tensors", [means, quats, scales, opacities, colors, viewmats, Ks, *behind])
    limits = Limits(width, height, near_plane, far_plane, radius_clip, eps2d, rasterize_mode == "antialiased")
    screen = project(means, scaled_axes(quats, scales), opacities, viewmats, Ks, limits)
    channels = _channels(colors, sh_degree, means, viewmats, screen.depth, render_mode)
    if absgrad and channels.shape[-1] > AT_ONCE:
        raise ValueError(f"absgrad with {channels.shape[-1]} channels: at most {AT_ONCE}")
    pairs = _Pairs.of(screen.drawn, packed)
    meta = _meta(screen, pairs) | {"width": width, "height": height, "tile_size": tile_size}
    images = _images(arrays, TileGrid(width, height), screen, channels, pairs, meta["means2d"], absgrad)
    lead = screen.depth.shape[:-1]
    image, opacity = (torch.stack(of).reshape(*lead, height, width, -1) for of in zip(*images, strict=True))
    return _finished(image, opacity, backgrounds, render_mode), opacity, meta


@dataclass(frozen=True)
class _Pairs:
    """The pairs of a camera and a Gaussian that are listed: all of them, or those that are drawn."""

    shape: torch.Size  # (..., C, N)
    index: torch.Tensor | None  # (M,) which of them in a flat list; None for all
    counts: list[int]  # of each image

    @staticmethod
    def of(drawn: torch.Tensor, packed: bool) -> _Pairs:
        images, count = math.prod(drawn.shape[:-1]), drawn.shape[-1]
        if not packed:
            return _Pairs(drawn.shape, None, [count] * images)
        by_image = drawn.reshape(images, count).sum(dim=1)
        return _Pairs(drawn.shape, drawn.flatten().nonzero()[:, 0], by_image.tolist())

    def rows(self, values: torch.Tensor) -> torch.Tensor:
        """(M, ...) what is listed of values (..., C, N, ...), in one list."""
        flat = values.flatten(0, len(self.shape) - 1)
        return flat if self.index is None else flat.index_select(0, self.index)


def _meta(screen: Screen, pairs: _Pairs) -> dict[str, Any]:
    *batches, cameras, count = pairs.shape
    found: dict[str, Any] = {
        "radii": screen.radii,
        "means2d": screen.means,
        "depths": screen.depth,
        "conics": screen.conics,
        "opacities": screen.opacity,
    }
    ids: list[torch.Tensor | None] = [None] * 3
    if pairs.index is not None:
        found = {name: pairs.rows(values) for name, values in found.items()}
        image = pairs.index // count
        ids = [image // cameras, image % cameras, pairs.index % count]
    found |= dict(zip(("batch_ids", "camera_ids", "gaussian_ids"), ids, strict=True))
    return found | {"n_batches": math.prod(batches), "n_cameras": cameras}


def _images(
    arrays: Arrays,
    grid: TileGrid,
    screen: Screen,
    channels: torch.Tensor,
    pairs: _Pairs,
    means2d: torch.Tensor,
    absgrad: bool,
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Images and opacities, one by one, from those means2d, which get absolute gradients as an attribute."""
    numbers = [screen.x_precision, screen.shear, screen.y_precision]
    shown = torch.where(screen.drawn, screen.opacity, 0)
    lists = [means2d.reshape(-1, 2), *map(pairs.rows, [*numbers, shown, channels, screen.depth])]
    absolute: Sequence[torch.Tensor | None] = [None] * len(pairs.counts)
    if absgrad:
        means2d.absgrad = torch.zeros_like(means2d)  # type: ignore[attr-defined]
        absolute = means2d.absgrad.view(-1, 2).split(pairs.counts)  # type: ignore[attr-defined]
    parts = zip(*(values.float().split(pairs.counts) for values in lists), strict=True)
    return [
        blended(arrays, FlatSplats(*part), grid, _RULES, own)
        for part, own in zip(parts, absolute, strict=True)
    ]


def _channels(
    colors: torch.Tensor,
    sh_degree: int | None,
    means: torch.Tensor,
    viewmats: torch.Tensor,
    depth: torch.Tensor,
    render_mode: str,
) -> torch.Tensor:
    """(..., C, N, X) what a mode shows of Gaussians at depths (..., C, N)."""
    channels = []
    if "RGB" in render_mode:
        if sh_degree is not None:
            colors = harmonic_colours(colors, sh_degree, means, viewmats)
        elif colors.dim() == means.dim():
            colors = colors[..., None, :, :]
        channels.append(colors.expand(*depth.shape, colors.shape[-1]))
    if render_mode != "RGB":
        channels.append(depth[..., None])
    return torch.cat(channels, dim=-1)


def _finished(
    image: torch.Tensor, opacity: torch.Tensor, backgrounds: torch.Tensor | None, render_mode: str
) -> torch.Tensor:
    """Images in front of their backgrounds, with expected depths if the mode has them."""
    colours, depth = (image, None) if render_mode == "RGB" else (image[..., :-1], image[..., -1:])
    if backgrounds is not None and colours.shape[-1]:
        colours = torch.addcmul(colours, 1 - opacity, backgrounds[..., None, None, :])
    if depth is None:
        return colours
    if "ED" in render_mode:
        depth = depth / opacity.clamp(min=_LEAST_OPACITY)
    return torch.cat([colours, depth], dim=-1)


def _refuse(others: dict[str, object]) -> None:
    for name, value in others.items():
        if name not in _REFUSED:
            raise TypeError(f"rasterization() has no argument {name!r}")
        default = _REFUSED[name]
        # Of an enumeration, what its value is called.
        if value is not default and (default is None or getattr(value, "name", value) != default):
            raise NotImplementedError(f"{name}: only its default, {default}, is supported")


def _check_choices(render_mode: str, rasterize_mode: str, eps2d: float, width: int, height: int) -> None:
    if render_mode not in _MODES:
        raise ValueError(f"render_mode {render_mode!r}: must be one of {', '.join(_MODES)}")
    if rasterize_mode not in ("classic", "antialiased"):
        raise ValueError(f"rasterize_mode {rasterize_mode!r}: must be classic or antialiased")
    if not 0 <= eps2d < math.inf:
        raise ValueError(f"eps2d of {eps2d:g} px^2: must be finite and not negative")
    if width < 1 or height < 1:
        raise ValueError(f"images of {width} x {height}: must have pixels")


def _check_shapes(means: torch.Tensor, viewmats: torch.Tensor, **others: torch.Tensor) -> None:
    if means.dim() < 2 or means.shape[-1] != 3:
        raise ValueError(f"means of shape {tuple(means.shape)}: must be (..., N, 3)")
    if viewmats.dim() < 3 or not viewmats.shape[-3]:
        raise ValueError(f"viewmats of shape {tuple(viewmats.shape)}: must be (..., C, 4, 4), C at least 1")
    *batches, count, _ = means.shape
    cameras = viewmats.shape[-3]
    expected = {
        "quats": (*batches, count, 4),
        "scales": (*batches, count, 3),
        "opacities": (*batches, count),
        "viewmats": (*batches, cameras, 4, 4),
        "Ks": (*batches, cameras, 3, 3),
    }
    for name, value in {"viewmats": viewmats, **others}.items():
        if value.shape != expected[name]:
            raise ValueError(f"{name} of shape {tuple(value.shape)}: must be {expected[name]}")


def _check_colors(
    colors: torch.Tensor, sh_degree: int | None, shape: torch.Size, backgrounds: torch.Tensor | None
) -> None:
    *batches, cameras, count = shape
    if sh_degree is None:
        wanted, own = "(..., N, D) or (..., C, N, D)", colors.shape[-1:]
        fits = own.numel() > 0
    else:
        if not 0 <= sh_degree <= _HIGHEST_DEGREE:
            raise ValueError(f"sh_degree {sh_degree}: must be 0 to {_HIGHEST_DEGREE}")
        least, own = (sh_degree + 1) ** 2, colors.shape[-2:]
        wanted = f"(..., N, K, 3) or (..., C, N, K, 3) with {least} harmonics or more"
        fits = len(own) == 2 and own[0] >= least and own[1] == 3
    of = list(colors.shape[: -len(own)])
    if not fits or of not in ([*batches, count], [*batches, cameras, count]):
        raise ValueError(f"colors of shape {tuple(colors.shape)}: must be {wanted}")
    if backgrounds is not None and backgrounds.shape != (*batches, cameras, own[-1]):
        expected = (*batches, cameras, own[-1])
        raise ValueError(f"backgrounds of shape {tuple(backgrounds.shape)}: must be {expected}")
