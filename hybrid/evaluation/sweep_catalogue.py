"""The sweeps by name, what each varies, and its rows as a table and in words.

Many repeat tables and figures of Foveated Path Culling (FPC).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import Any

from compose.base.errors import UserError
from compose.camera.camera import Camera, View
from compose.eye.acuity import ACUITY_MODELS
from compose.fovea.foveation import FoveaMode, Placement
from hybrid.render.frame_settings import FrameSettings

# Published by FPC, of its own scene and renderers on an RTX 3060: ratios are comparable with ours, times are
# not. (width, height): frames per second of FPC and of its path tracing. Tables 4 and 5.
FPC_TABLE_4 = {
    (800, 600): (265.4, 330.2),
    (1012, 1061): (195.2, 152.0),
    (1954, 1061): (107.0, 77.7),
    (3316, 1061): (66.5, 46.4),
}
FPC_TABLE_5 = {
    (782, 820): (248.4, 253.1),
    (859, 900): (224.0, 210.0),
    (930, 975): (211.2, 180.5),
    (1012, 1061): (195.2, 152.0),
}
# Radius in percent of the height up to which FPC is faster than path tracing: Figures 8, 9, 10 and 7. In
# Figure 7 it is faster up to the largest radius.
FPC_BREAK_EVEN = {(1280, 780): 51.0, (1012, 1061): 50.0, (1954, 1061): 85.0, (3316, 1061): 90.0}
# Samples per pixel: frames per second by radius in percent. Path tracing has 150 at one sample (Figure 14).
FPC_FIGURE_14 = {1: {10: 200, 90: 100}, 2: {10: 192, 90: 67}, 4: {10: 166, 90: 40}, 6: {10: 151, 90: 30}}
FPC_FIGURE_14_FULL = 150.0
FPC_FIGURE_14_SIZE, FPC_FIGURE_14_RADII = (1012, 1061), (10, 20, 50, 90)
# Frame sizes of Figures 12 and 13.
FPC_VIEW_SIZES = ((1280, 780), (3316, 1061))

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
    base: Setting, varied: dict[str, Any], frame: FrameSettings, size: tuple[int, int] | None = None
) -> Setting:
    """The base with other frame settings, and another frame size."""
    camera = base.camera if size is None else base.camera.resized(*size)
    return replace(base, camera=camera, frame=frame, varied=varied)


def _sides(size: tuple[int, int]) -> dict[str, Any]:
    return {"width": size[0], "height": size[1]}


def _sizes(table: dict[tuple[int, int], tuple[float, float]]) -> Settings:
    return lambda base, views: [
        replace(_with(base, _sides(size), base.frame, size), paper={"ratio": hybrid / full})
        for size, (hybrid, full) in table.items()
    ]


def _radius(base: Setting, views: list[View]) -> list[Setting]:
    return [
        _with(base, {**_sides(size), "radius": radius}, base.frame.with_radius(float(radius)), size)
        for size in FPC_BREAK_EVEN
        for radius in _RADII
    ]


def _spp(base: Setting, views: list[View]) -> list[Setting]:
    rows = []
    for spp, known in FPC_FIGURE_14.items():
        for radius in FPC_FIGURE_14_RADII:
            frame = replace(base.frame.with_radius(float(radius)), spp=spp)
            row = _with(base, {"spp": spp, "radius": radius}, frame, FPC_FIGURE_14_SIZE)
            # FPC compares all sample counts with path tracing at one sample per pixel.
            paper = {"ratio_1spp": known[radius] / FPC_FIGURE_14_FULL} if radius in known else {}
            rows.append(replace(row, paper=paper, over_one_spp=True))
    return rows


def _view(base: Setting, views: list[View]) -> list[Setting]:
    return [
        replace(
            base,
            frame=base.frame.with_radius(float(radius)),
            varied={**_sides(size), "view": number, "radius": radius},
            camera=view.camera.resized(*size),
            views=(view.resized(*size),),
        )
        for size in FPC_VIEW_SIZES
        for number, view in enumerate(views)
        for radius in _VIEW_RADII
    ]


def _varying(base: Setting, frames: Iterable[FrameSettings], *names: str) -> list[Setting]:
    """A row for each of some settings of frames, of which the named ones vary."""
    known = ((frame, frame.as_json()) for frame in frames)
    return [replace(base, frame=frame, varied={name: has[name] for name in names}) for frame, has in known]


def _band(base: Setting, views: list[View]) -> list[Setting]:
    radii = ((outer, outer * share) for outer in _BAND_OUTER for share in _BAND_SHARES)
    frames = (replace(base.frame, fov_a=outer, fov_b=inner) for outer, inner in radii)
    return _varying(base, frames, "fov_a", "fov_b")


def _acuity_models(base: Setting, views: list[View]) -> list[Setting]:
    frames = (replace(base.frame, acuity_model=name) for name in ACUITY_MODELS)
    return _varying(base, frames, "acuity_model")


def _denoiser(base: Setting, views: list[View]) -> list[Setting]:
    frames = (replace(base.frame, fovea=mode, spp=spp) for spp in _DENOISER_SPP for mode in FoveaMode)
    return _varying(base, frames, "fovea", "spp")


def _paths(base: Setting, views: list[View]) -> list[Setting]:
    several = product((FoveaMode.DENOISED, FoveaMode.FUSED), _PATHS_SPP, Placement)
    frames = (replace(base.frame, fovea=mode, spp=spp, paths=paths) for mode, spp, paths in several)
    return _varying(base, frames, "fovea", "spp", "paths")


def _trade(base: Setting, views: list[View]) -> list[Setting]:
    several = product(_TRADE_OUTER, _TRADE_SPP, (FoveaMode.DENOISED, FoveaMode.FUSED))
    frames = (replace(base.frame.with_radius(outer), spp=spp, fovea=mode) for outer, spp, mode in several)
    return _varying(base, frames, "fovea", "spp", "fov_a", "fov_b")


SWEEPS = {
    "resolution": Sweep(_sizes(FPC_TABLE_4), "resolutions (FPC, Table 4)", sets=("size",)),
    "aspect": Sweep(_sizes(FPC_TABLE_5), "resolutions of one aspect ratio (FPC, Table 5)", sets=("size",)),
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
            _with(
                base,
                {"layers": f"{low} to {high}", "gaussians": counts[high - 1]},
                replace(base.frame, layers=(low, high)),
            )
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


def table(rows: list[dict[str, Any]], forms: Mapping[str, str] | None = None) -> dict[str, list[str]]:
    """Cells of a sweep's rows by column name; columns that no row has are left out.

    The forms are those of the metrics that are shown, by name.
    """
    columns = {name: [short(row[name]) for row in rows] for name in varied(rows[0])}
    columns["covered, %"] = [f"{100 * row['covered']:.1f}" if "covered" in row else "-" for row in rows]
    columns["ms"] = [with_range(row["ms"]["p50"], row.get("ms_range"), ".0f") for row in rows]
    columns["full, ms"] = [f"{row['full_ms']['p50']:.0f}" for row in rows]
    papers = [row.get("paper", {}) for row in rows]
    for key, name in (("ratio", "ratio"), ("ratio_1spp", "ratio to 1 spp")):
        columns[name] = _ratios(rows, key)
        columns[f"FPC's {name}"] = _ratios(papers, key)
    for name in rows[0].get("quality", {}):
        if form := (forms or {}).get(name.split()[1]):
            columns[name] = [
                with_range(row["quality"][name], row.get("quality_range", {}).get(name), form) for row in rows
            ]
    return {name: cells for name, cells in columns.items() if set(cells) != {"-"}}


def with_range(value: float, between: Sequence[float] | None, format_spec: str, unit: str = "") -> str:
    """A mean or median over views with the least and the greatest value of a view, if there are several."""
    cell = format(value, format_spec) + unit
    return cell if between is None else f"{cell} ({'–'.join(format(end, format_spec) for end in between)})"


def _ratios(rows: list[dict[str, Any]], name: str) -> list[str]:
    return [with_range(row[name], row.get(f"{name}_range"), ".2f") if name in row else "-" for row in rows]


def short(value: object) -> str:
    """A varied quantity in a cell or a label."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def break_even(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Where hybrid and full path-traced frames take equally long, for each resolution of a radius sweep.

    `radius` is where the ratio of medians falls below 1, `slower_from` where its whole confidence interval
    does; None if that happens at no measured radius.
    """
    found = []
    for size in dict.fromkeys((row["width"], row["height"]) for row in rows):
        same = [row for row in rows if (row["width"], row["height"]) == size]
        radii = [row["radius"] for row in same]
        found.append(
            {
                "width": size[0],
                "height": size[1],
                "radius": _crossing(radii, [row["ratio"] for row in same]),
                "slower_from": _crossing(radii, [row["ratio_interval"][1] for row in same]),
                "least_ratio": min(row["ratio"] for row in same),
                "paper": FPC_BREAK_EVEN.get(size),
            }
        )
    return found


def sentence(row: dict[str, Any]) -> str:
    """A row of `break_even` in words."""
    radius = "more than 90" if row["radius"] is None else f"{row['radius']:.0f}"
    slower = "at no radius" if row["slower_from"] is None else f"from {row['slower_from']:.0f} % on"
    return (
        f"{row['width']}x{row['height']}: as fast as full path tracing at a radius of {radius} % of the "
        f"height (FPC: {row['paper']:.0f}), slower with 95 % confidence {slower}; "
        f"lowest ratio {row['least_ratio']:.3f}."
    )


def _crossing(radii: list[float], ratios: list[float]) -> float | None:
    """Where ratios first fall below 1, interpolated linearly between radii."""
    if ratios[0] < 1:
        return radii[0]
    for (before, ratio), (after, after_ratio) in pairwise(zip(radii, ratios, strict=True)):
        if ratio >= 1 > after_ratio:
            return before + (ratio - 1) / (ratio - after_ratio) * (after - before)
    return None
