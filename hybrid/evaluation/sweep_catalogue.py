"""The sweeps by name, and what each varies; many repeat tables and figures of Foveated Path Culling (FPC)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from compose.base.errors import UserError
from compose.camera.camera import Camera, View
from compose.eye.acuity import ACUITY_MODELS
from compose.fovea.foveation import FoveaMode, Placement
from hybrid.evaluation import fpc
from hybrid.render.frame_settings import FrameSettings

_RADII = (10, 20, 30, 40, 50, 60, 70, 80, 90)
_VIEW_RADII = (20, 50)
_TRADE_OUTER, _TRADE_SPP = (5.0, 10.0, 20.0, 30.0), (1, 2, 4, 8)
_BAND_OUTER, _BAND_SHARES = (10.0, 20.0, 30.0, 40.0), (0.25, 0.5, 0.75, 1.0)
_DENOISER_SPP = (1, 2, 4, 16)
_PATHS_SPP = (1, 4)


@dataclass(frozen=True)
class Setting:
    """A row of a sweep: a hybrid frame.

    Attributes:
        camera: the scene's own view, at the size of the frames.
        frame: settings of the frame, apart from gaze and camera.
        varied: the quantities that the sweep varies, by name.
        paper: FPC's ratios for this row, by the names of ours; empty if unknown.
        over_one_spp: whether to compare with the full path-traced frame at one sample per pixel as well.
        views: whose frames are timed and judged, of the same size; only the camera's if empty.
    """

    camera: Camera
    frame: FrameSettings
    varied: dict[str, Any] = field(default_factory=dict)
    paper: dict[str, float] = field(default_factory=dict)
    over_one_spp: bool = False
    views: tuple[View, ...] = ()

    @property
    def seen(self) -> tuple[View, ...]:
        """The views whose frames are timed and judged, at least one."""
        return self.views or (View(self.camera),)

    def from_views(self, views: list[View]) -> Setting:
        """The same, timed and judged in those views, at the size of its frames."""
        size = self.camera.width, self.camera.height
        return replace(self, views=tuple(view.resized(*size) for view in views))

    @property
    def is_denoised(self) -> bool:
        """Whether its fovea, and so the full path-traced frame it is compared with, is denoised."""
        return self.frame.fovea is not FoveaMode.RAW


@dataclass(frozen=True)
class SweepEffort:
    """How much a sweep measures: frames per row, after those of the warm-up, and samples of references."""

    repeats: int
    warm_up: int
    reference_spp: int


def varied(row: dict[str, Any]) -> dict[str, Any]:
    """The varied quantities of a sweep's row: all entries before the times."""
    names = list(row)
    return {name: row[name] for name in names[: names.index("ms")]}


# From the setting to vary, and further views of the scene, to the rows of a sweep.
Settings = Callable[[Setting, list[View]], list[Setting]]


@dataclass(frozen=True)
class Sweep:
    """A sweep: the rows that it makes, its title, and whether it measures quality as well as time.

    Attributes:
        sets: quantities that it sets itself: size, fovea, fov_a, fov_b, spp or acuity_model.
        scales_radii: whether it sets fov_a and keeps the ratio of the two radii.
        over_views: whether its rows are views; the rows of the others are measured in several.
    """

    settings: Settings
    title: str
    with_quality: bool = False
    sets: tuple[str, ...] = ()
    scales_radii: bool = False
    over_views: bool = False

    @property
    def ignored(self) -> tuple[str, ...]:
        """Quantities of the base that have no influence on it."""
        return self.sets if self.with_quality else (*self.sets, "reference_spp")


def _with(
    base: Setting,
    varied: dict[str, Any],
    size: tuple[int, int] | None = None,
    radius: float | None = None,
    **frame: Any,
) -> Setting:
    """The base with another frame size, fov-a (and fov-b in proportion), and other frame settings."""
    settings = base.frame if radius is None else base.frame.with_radius(float(radius))
    camera = base.camera if size is None else base.camera.resized(*size)
    return replace(base, camera=camera, frame=replace(settings, **frame), varied=varied)


def _sides(size: tuple[int, int]) -> dict[str, Any]:
    return {"width": size[0], "height": size[1]}


def _sizes(table: dict[tuple[int, int], tuple[float, float]]) -> Settings:
    """The frame sizes of one of FPC's tables."""
    return lambda base, views: [
        replace(_with(base, _sides(size), size), paper={"ratio": hybrid / full})
        for size, (hybrid, full) in table.items()
    ]


def _radius(base: Setting, views: list[View]) -> list[Setting]:
    return [
        _with(base, {**_sides(size), "radius": radius}, size, radius)
        for size in fpc.BREAK_EVEN
        for radius in _RADII
    ]


def _spp(base: Setting, views: list[View]) -> list[Setting]:
    rows = []
    for spp, known in fpc.FIGURE_14.items():
        for radius in fpc.FIGURE_14_RADII:
            row = _with(base, {"spp": spp, "radius": radius}, fpc.FIGURE_14_SIZE, radius, spp=spp)
            # FPC compares all sample counts with path tracing at one sample per pixel.
            paper = {"ratio_1spp": known[radius] / fpc.FIGURE_14_FULL} if radius in known else {}
            rows.append(replace(row, paper=paper, over_one_spp=True))
    return rows


def _view(base: Setting, views: list[View]) -> list[Setting]:
    return [
        replace(
            _with(base, {**_sides(size), "view": number, "radius": radius}, radius=radius),
            camera=view.camera.resized(*size),
            views=(view.resized(*size),),
        )
        for size in fpc.VIEW_SIZES
        for number, view in enumerate(views)
        for radius in _VIEW_RADII
    ]


def _band(base: Setting, views: list[View]) -> list[Setting]:
    radii: list[dict[str, Any]] = [
        {"fov_a": outer, "fov_b": outer * share} for outer in _BAND_OUTER for share in _BAND_SHARES
    ]
    return [_with(base, both, **both) for both in radii]


def _acuity_models(base: Setting, views: list[View]) -> list[Setting]:
    return [_with(base, {"acuity_model": name}, acuity_model=name) for name in ACUITY_MODELS]


def _denoiser(base: Setting, views: list[View]) -> list[Setting]:
    return [
        _with(base, {"fovea": mode.value, "spp": spp}, fovea=mode, spp=spp)
        for spp in _DENOISER_SPP
        for mode in FoveaMode
    ]


def _paths(base: Setting, views: list[View]) -> list[Setting]:
    return [
        _with(base, {"fovea": mode.value, "spp": spp, "paths": one.value}, fovea=mode, spp=spp, paths=one)
        for mode in (FoveaMode.DENOISED, FoveaMode.FUSED)
        for spp in _PATHS_SPP
        for one in Placement
    ]


def _trade(base: Setting, views: list[View]) -> list[Setting]:
    rows = []
    for frame in (base.frame.with_radius(outer) for outer in _TRADE_OUTER):
        for spp in _TRADE_SPP:
            for mode in (FoveaMode.DENOISED, FoveaMode.FUSED):
                radii: dict[str, Any] = {"fov_a": frame.fov_a, "fov_b": frame.fov_b}
                varied = {"fovea": mode.value, "spp": spp, **radii}
                rows.append(_with(base, varied, fovea=mode, spp=spp, **radii))
    return rows


SWEEPS = {
    "resolution": Sweep(_sizes(fpc.TABLE_4), "resolutions (FPC, Table 4)", sets=("size",)),
    "aspect": Sweep(_sizes(fpc.TABLE_5), "resolutions of one aspect ratio (FPC, Table 5)", sets=("size",)),
    "radius": Sweep(_radius, "radius of the fovea (FPC, Figures 7 to 10)", sets=("size",), scales_radii=True),
    "spp": Sweep(_spp, "samples per pixel (FPC, Figure 14)", sets=("size", "spp"), scales_radii=True),
    "view": Sweep(
        _view, "views (FPC, Figures 12 and 13)", sets=("size",), scales_radii=True, over_views=True
    ),
    "band": Sweep(_band, "fov-a and fov-b", with_quality=True, sets=("fov_a", "fov_b")),
    "acuity": Sweep(_acuity_models, "acuity models", with_quality=True, sets=("acuity_model",)),
    "trade": Sweep(
        _trade,
        "settings that `hybrid render --target-ms` chooses from",
        with_quality=True,
        sets=("fovea", "spp"),
        scales_radii=True,
    ),
    "denoiser": Sweep(_denoiser, "how the fovea is made", with_quality=True, sets=("fovea", "spp")),
    "paths": Sweep(_paths, "where paths are traced", with_quality=True, sets=("fovea", "spp")),
}


def layer_sweep(counts: tuple[int, ...]) -> Sweep:
    """The sweep over layers, given their nodes, coarsest first: without the finest or the coarsest ones."""
    last = len(counts)
    spans = [(1, high) for high in range(1, last + 1)] + [(low, last) for low in range(2, last + 1)]

    def settings(base: Setting, views: list[View]) -> list[Setting]:
        return [
            _with(base, {"layers": f"{low} to {high}", "gaussians": counts[high - 1]}, layers=(low, high))
            for low, high in spans
        ]

    return Sweep(settings, "layers and Gaussians", with_quality=True)


def sweep_named(name: str, counts: tuple[int, ...]) -> Sweep:
    """The sweep of that name, for nodes per layer of a forest, coarsest first; UserError if there is none."""
    known = {**SWEEPS, "layers": layer_sweep(counts)}
    if name not in known:
        names = list(known)
        raise UserError(f"sweep over {name}: must be over {', '.join(names[:-1])} or {names[-1]}")
    return known[name]
