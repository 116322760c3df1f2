"""What each sweep varies, and FPC's figures for it.

Frame rates of FPC are those of its own scene and renderers on an RTX 3060: ratios can be compared with them,
times cannot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.fovea.mode import MODES
from hybrid.frame.periphery import Viewing
from hybrid.sweeps.setting import Setting

# Width and height: (FPC's frames per second, those of its path tracing). Table 4, Table 5.
_TABLE_4 = {
    (800, 600): (265.4, 330.2),
    (1012, 1061): (195.2, 152.0),
    (1954, 1061): (107.0, 77.7),
    (3316, 1061): (66.5, 46.4),
}
_TABLE_5 = {
    (782, 820): (248.4, 253.1),
    (859, 900): (224.0, 210.0),
    (930, 975): (211.2, 180.5),
    (1012, 1061): (195.2, 152.0),
}
# Radius in percent of the height up to which FPC is faster: Figures 8, 9 and 10; in Figure 7 up to the last.
BREAK_EVEN = {(1280, 780): 51.0, (1012, 1061): 50.0, (1954, 1061): 85.0, (3316, 1061): 90.0}
_RADII = (10, 20, 30, 40, 50, 60, 70, 80, 90)
# Samples per pixel: FPC's frames per second at radii of 10 and 90 percent; path tracing has 150 (Figure 14).
_FIGURE_14 = {1: (200, 100), 2: (192, 67), 4: (166, 40), 6: (151, 30)}
_FIGURE_14_FULL = 150.0
_FIGURE_14_SIZE, _FIGURE_14_RADII = (1012, 1061), (10, 20, 50, 90)
_VIEW_SIZES, _VIEW_RADII = ((1280, 780), (3316, 1061)), (20, 50)
_TRADE_OUTER, _TRADE_SPP = (5.0, 10.0, 20.0, 30.0), (1, 2, 4, 8)
_BAND_OUTER, _BAND_SHARES = (10.0, 20.0, 30.0, 40.0), (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Sweep:
    """A sweep.

    Attributes:
        settings: its rows, from the setting to vary and further views of the scene.
        title: what its table shows.
        judged: whether quality is measured as well as time.
        fixes: options of `hybrid sweep` that it sets itself.
        scales_radii: whether it sets fov-a, and of the options' radii their ratio alone counts.
    """

    settings: Callable[[Setting, list[Camera]], list[Setting]]
    title: str
    judged: bool = False
    fixes: tuple[str, ...] = ()
    scales_radii: bool = False

    @property
    def ignored(self) -> tuple[str, ...]:
        """Options that change nothing in it."""
        return self.fixes if self.judged else (*self.fixes, "--reference-spp")


def _sizes(table: dict[tuple[int, int], tuple[float, float]]) -> Callable[..., list[Setting]]:
    def settings(base: Setting, views: list[Camera]) -> list[Setting]:
        return [
            replace(
                base,
                varied={"width": width, "height": height},
                camera=base.camera.resized(width, height),
                paper={"ratio": ours / full},
            )
            for (width, height), (ours, full) in table.items()
        ]

    return settings


def _of_radius(base: Setting, radius: float) -> Setting:
    """With a fovea of that radius, in percent of the height, and a band of the same share of it."""
    return replace(base, fov_a=float(radius), fov_b=base.fov_b / base.fov_a * radius)


def _radius(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(
            _of_radius(base, radius),
            varied={"width": width, "height": height, "radius": radius},
            camera=base.camera.resized(width, height),
        )
        for width, height in BREAK_EVEN
        for radius in _RADII
    ]


def _spp(base: Setting, views: list[Camera]) -> list[Setting]:
    rows = []
    for spp, known in _FIGURE_14.items():
        for radius in _FIGURE_14_RADII:
            fps = dict(zip((10, 90), known, strict=True)).get(radius)
            # FPC compares all of them with path tracing at one sample per pixel.
            paper = {} if fps is None else {"ratio_1spp": fps / _FIGURE_14_FULL}
            row = replace(_of_radius(base, radius), varied={"spp": spp, "radius": radius}, paper=paper)
            camera = base.camera.resized(*_FIGURE_14_SIZE)
            rows.append(replace(row, camera=camera, spp=spp, over_one_spp=True))
    return rows


def _view(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(
            _of_radius(base, radius),
            varied={"width": width, "height": height, "view": number, "radius": radius},
            camera=view.resized(width, height),
        )
        for width, height in _VIEW_SIZES
        for number, view in enumerate(views)
        for radius in _VIEW_RADII
    ]


def _band(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(
            base, varied={"fov_a": outer, "fov_b": outer * share}, fov_a=float(outer), fov_b=outer * share
        )
        for outer in _BAND_OUTER
        for share in _BAND_SHARES
    ]


def _acuity_models(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(
            base,
            varied={"acuity_model": acuity_model},
            viewing=replace(base.viewing, acuity_model=acuity_model),
        )
        for acuity_model in ACUITY_MODELS
    ]


def _denoiser(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(base, varied={"fovea": mode, "spp": spp}, fovea=mode, spp=spp)
        for spp in (1, 2, 4, 16)
        for mode in MODES
    ]


def _trade(base: Setting, views: list[Camera]) -> list[Setting]:
    return [
        replace(
            wide,
            varied={"fovea": fovea, "spp": spp, "fov_a": wide.fov_a, "fov_b": wide.fov_b},
            fovea=fovea,
            spp=spp,
        )
        for wide in (_of_radius(base, outer) for outer in _TRADE_OUTER)
        for spp in _TRADE_SPP
        for fovea in ("denoised", "fused")
    ]


SWEEPS = {
    "resolution": Sweep(_sizes(_TABLE_4), "resolutions (FPC, Table 4)", fixes=("--size",)),
    "aspect": Sweep(_sizes(_TABLE_5), "resolutions of one aspect ratio (FPC, Table 5)", fixes=("--size",)),
    "radius": Sweep(
        _radius, "radius of the fovea (FPC, Figures 7 to 10)", fixes=("--size",), scales_radii=True
    ),
    "spp": Sweep(_spp, "samples per pixel (FPC, Figure 14)", fixes=("--size", "--spp"), scales_radii=True),
    "view": Sweep(_view, "views (FPC, Figures 12 and 13)", fixes=("--size",), scales_radii=True),
    "band": Sweep(_band, "fov-a and fov-b", judged=True, fixes=("--fov-a", "--fov-b")),
    "acuity_model": Sweep(_acuity_models, "acuity models", judged=True, fixes=("--acuity-model",)),
    "trade": Sweep(
        _trade,
        "settings that `hybrid render --target-ms` chooses from",
        judged=True,
        fixes=("--fovea", "--spp"),
        scales_radii=True,
    ),
    "denoiser": Sweep(_denoiser, "how the fovea is made", judged=True, fixes=("--fovea", "--spp")),
}


def layer_sweep(layers: int, nodes: tuple[int, ...]) -> Sweep:
    """Fewer Gaussians: finest layers left out, and coarsest ones."""

    def settings(base: Setting, views: list[Camera]) -> list[Setting]:
        spans = [(1, high) for high in range(1, layers + 1)] + [(low, layers) for low in range(2, layers + 1)]
        return [
            replace(
                base,
                varied={"layers": f"{low} to {high}", "gaussians": nodes[high - 1]},
                viewing=Viewing(base.viewing.display, base.viewing.acuity_model, (low, high)),
            )
            for low, high in spans
        ]

    return Sweep(settings, "layers and Gaussians", judged=True)


def sweep_named(name: str, counts: tuple[int, ...]) -> Sweep:
    """The sweep of that name, for a forest with layers of so many nodes.

    Raises:
        UserError: there is none.
    """
    known: dict[str, Any] = {**SWEEPS, "layers": layer_sweep(len(counts), counts)}
    if name not in known:
        raise UserError(f"--over {name}: must be {', '.join(list(known)[:-1])} or {list(known)[-1]}")
    found: Sweep = known[name]
    return found
