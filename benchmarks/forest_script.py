"""The command line of scripts that measure one forest of a scene."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compose.base.files import json_text


def run(description: str | None, measured: Callable[[str, Path], dict[str, Any]]) -> None:
    """Measures SCENE with --forest, prints what was found, and writes it if --json asks for it."""
    from pathtrace.scene.backend import select_backend

    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene")
    parser.add_argument("--forest", type=Path, required=True)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    select_backend()
    text = json_text(measured(options.scene, options.forest))
    print(text)
    if options.json:
        options.json.write_text(text)
