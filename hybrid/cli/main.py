"""The command line: its commands, and how mistakes end."""

from __future__ import annotations

import io
import os
import sys

import typer

from compose.base.errors import UserError
from hybrid.cli import options as o
from hybrid.cli.bench import bench_app
from hybrid.cli.capture import capture
from hybrid.cli.demo import demo
from hybrid.cli.doctor import doctor
from hybrid.cli.evaluate import evaluate
from hybrid.cli.exchange import export_file, import_file
from hybrid.cli.many_machines import merge
from hybrid.cli.prepare import plan, prepare, quickstart
from hybrid.cli.progress import messages_as_lines
from hybrid.cli.render import render
from hybrid.cli.scenes import scenes
from hybrid.cli.serve import serve
from hybrid.cli.study import study_app
from hybrid.cli.sweep import sweep
from hybrid.cli.train import levels, train

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Path-traced fovea, Gaussian-splat periphery: one scene, two renderers, one frame.",
)
for command in (
    doctor,
    scenes,
    quickstart,
    plan,
    prepare,
    capture,
    train,
    levels,
    render,
    demo,
    serve,
    evaluate,
    sweep,
    merge,
):
    app.command()(o.with_json(command))
app.command("export")(export_file)
app.command("import")(import_file)
app.add_typer(study_app, name="study")
app.add_typer(bench_app, name="bench")


def main() -> None:
    """Entry point: a user's mistake is one line and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        # Not every locale has all characters.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    # That of a notebook may be set, for which this environment may have no package.
    os.environ["MPLBACKEND"] = "agg"
    try:
        with messages_as_lines():
            app()
    except UserError as error:
        print(f"hybrid: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
