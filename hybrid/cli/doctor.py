"""`hybrid doctor`: checks the installation."""

from __future__ import annotations

from compose.base.errors import UserError
from hybrid.cli import options as o


def doctor(backend: o.Backend = "auto", json_file: o.Json = None) -> None:
    """Say which backend runs, why, and what to install if something is missing."""
    from hybrid.base.installation import examine

    report = examine(backend)
    for line in report.lines():
        print(line)
    o.write_json(json_file, report.facts)
    if report.problem:
        raise UserError(report.problem)
