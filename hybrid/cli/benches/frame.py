"""`hybrid bench frame`."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli.options import (
    FRAME,
    Backend,
    ForestFile,
    FovA,
    FovB,
    Json,
    Repeats,
    SceneName,
    Seed,
    Spp,
    ThinGlass,
    WarmUp,
    loaded_scene,
    require_size,
    select,
    write_json,
)
from hybrid.frame.settings import DEFAULTS, INTERACTIVE, FrameSettings
from hybrid.runtime.progress import progress_bar

_SIZES = ((640, 480), (1920, 1080))
_HEADER = (
    "backend   size       fovea     renderer  wall ms    p95  kernels ms  launches    host bytes  "
    "longest passes, ms"
)


def frame(
    scene: SceneName,
    forest: ForestFile = None,
    size: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="W H",
            help="Frame size; 640 480 and 1920 1080 if left out.",
            rich_help_panel=FRAME,
        ),
    ] = None,
    fov_a: FovA = DEFAULTS.fov_a,
    fov_b: FovB = DEFAULTS.fov_b,
    spp: Spp = INTERACTIVE.spp,
    repeats: Repeats = 15,
    warm_up: WarmUp = 5,
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time whole frames in each mode, still and live, while the gaze moves, and count what passes the host.

    Without --backend, on all backends that are present, one after the other.
    """
    sizes = _SIZES if size is None else (size,)
    for one in sizes:
        require_size(one)
    settings = FrameSettings(fov_a=fov_a, fov_b=fov_b, spp=spp)
    select(backend)
    from compose import LLVM
    from hybrid.bench.frame import bench_frame
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.device import device_arrays

    loaded = loaded_scene(scene, None, thin_glass)
    found = forest_for(loaded, forest)
    with progress_bar("bench (rounds)") as bar:
        rows = bench_frame(loaded, found, settings, sizes, repeats, warm_up, seed, bar)
    if backend == "auto" and device_arrays().backend == "cuda" and not isinstance(LLVM, UserError):
        rows += on_llvm(sys.argv[1:])
    print(_HEADER)
    for row in rows:
        print(_line(row))
    write_json(json_file, rows)


def on_llvm(arguments: list[str]) -> list[dict[str, Any]]:
    """Rows of the same command on LLVM, in a process of its own: a process has one backend.

    Args:
        arguments: of this command. What is given twice counts as given last.

    Raises:
        UserError: the process failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.json"
        further = ["--backend", "llvm", "--json", str(file)]
        command = [sys.executable, "-m", "hybrid.cli.main", *arguments, *further]
        code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
        if code:
            raise UserError(f"backend llvm: its process ended with exit code {code}; try --backend cuda")
        rows: list[dict[str, Any]] = json.loads(file.read_text())
        return rows


def _line(row: dict[str, Any]) -> str:
    medians = {name: times["p50"] for name, times in row["passes"].items() if name != "total"}
    longest = sorted(medians, key=lambda name: medians[name], reverse=True)[:3]
    renderer, wall = "live" if row["live"] else "still", row["wall_ms"]
    return (
        f"{row['backend']:<8} {row['width']:>5}x{row['height']:<5} {row['mode']:<9} {renderer:<8} "
        f"{wall['p50']:>8.1f} {wall['p95']:>6.1f} {row['kernels_ms']:>11.1f} {row['launches']:>9} "
        f"{row['host_bytes']:>13,}  " + ", ".join(f"{name} {medians[name]:.1f}" for name in longest)
    )
