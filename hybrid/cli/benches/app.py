"""`hybrid bench`: commands that measure one part alone."""

from __future__ import annotations

import typer

from hybrid.cli.benches.frame import frame
from hybrid.cli.benches.integrator import integrator
from hybrid.cli.benches.moving import moving
from hybrid.cli.benches.periphery import periphery
from hybrid.cli.benches.raster import raster

bench_app = typer.Typer(no_args_is_help=True, help="Measure one part alone.")
for command in (raster, integrator, periphery, frame, moving):
    bench_app.command()(command)
