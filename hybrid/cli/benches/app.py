"""`hybrid bench`: commands that measure one part alone."""

from __future__ import annotations

import typer

from hybrid.cli.benches.change import change
from hybrid.cli.benches.endurance import endurance
from hybrid.cli.benches.forest import forest
from hybrid.cli.benches.frame import frame
from hybrid.cli.benches.fusion import fusion
from hybrid.cli.benches.gaze import gaze
from hybrid.cli.benches.held_out import held_out
from hybrid.cli.benches.integrator import integrator
from hybrid.cli.benches.motion import motion
from hybrid.cli.benches.moving import moving
from hybrid.cli.benches.passes import passes
from hybrid.cli.benches.periphery import periphery
from hybrid.cli.benches.plan import plan
from hybrid.cli.benches.raster import raster
from hybrid.cli.benches.relighting import relighting
from hybrid.cli.benches.seam import seam
from hybrid.cli.benches.separation import separation
from hybrid.cli.benches.still import still

bench_app = typer.Typer(no_args_is_help=True, help="Measure one part alone.")
for command in (
    raster,
    integrator,
    relighting,
    periphery,
    gaze,
    forest,
    passes,
    frame,
    fusion,
    change,
    motion,
    moving,
    seam,
    separation,
    plan,
    still,
    endurance,
):
    bench_app.command()(command)
bench_app.command("held-out")(held_out)
