"""Identities of cached results: inputs, code and machine, so that different ones are never mixed."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from compose.base.errors import UserError, one_line

if TYPE_CHECKING:
    from pathtrace.dataset.frame_set import FrameSet
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest


_LIBRARIES = ("mitsuba", "drjit", "torch", "numpy")
# The packages of this project, and the library whose version `machine` does not have.
_PACKAGES, _DENOISER = ("compose", "pathtrace", "splat", "hybrid"), "mitsuba-oidn"


def machine() -> dict[str, Any]:
    """Everything that measured times depend on: hardware, backend and software versions.

    The gpu is None on the CPU backend, or if the driver does not report it; the backend is Mitsuba's variant,
    and the version that of this project.
    """
    backend = mi.variant()
    cards = sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
    on_card = str(backend).startswith("cuda") and cards
    return {
        "cpu": _first_value(Path("/proc/cpuinfo"), "model name")
        or platform.processor()
        or platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "gpu": _first_value(cards[0], "Model") if on_card else None,
        "backend": backend,
        "python": platform.python_version(),
        "version": version("foveated-hybrid-renderer"),
        "packages": {name: version(name) for name in _LIBRARIES},
    }


def _first_value(file: Path, name: str) -> str | None:
    """Value of the first line `name : value` of a file; None if there is none."""
    try:
        lines = file.read_text().splitlines()
    except OSError:
        return None
    pairs = (line.split(":", 1) for line in lines if ":" in line)
    return next((value.strip() for key, value in pairs if key.strip() == name), None)


def measured_identity(scene: Scene, forest: Forest, **settings: Any) -> dict[str, Any]:
    """Everything that measured times and quality depend on: what was measured, the code and the machine.

    The settings are everything else that the results depend on, in types that JSON has.
    """
    paths = {"max_depth": scene.max_depth, "roulette_depth": scene.roulette_depth}
    rendered = {"scene": scene.hash, **paths, "forest": forest.digest()}
    return {**rendered, **settings, "code": code(), "machine": machine()}


@cache
def code() -> dict[str, str | None]:
    """Digest of this project's source, and the denoiser's version; `machine` has those of other packages."""
    root, digest = Path(__file__).parents[2], hashlib.sha256()
    for file in sorted(file for package in _PACKAGES for file in (root / package).rglob("*.py")):
        digest.update(f"{file.relative_to(root).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return {"source": digest.hexdigest()[:16], _DENOISER: installed_version(_DENOISER)}


def installed_version(package: str) -> str | None:
    """Version of a package; None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def short_hash(identity: dict[str, Any]) -> str:
    """Twelve hexadecimal digits that distinguish identities in file names."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:12]


def require_same(found: dict[str, Any], expected: dict[str, Any], what: str, advice: str) -> None:
    """Checks that cached results, as read from JSON, belong to the work that would use them.

    UserError says what they are and where, which entries differ, and what the user can do.
    """
    # JSON turns tuples into lists.
    expected = json.loads(json.dumps(expected))
    differing = sorted(key for key in {*found, *expected} if found.get(key) != expected.get(key))
    if differing:
        raise UserError(f"{what} for other inputs ({one_line(', '.join(differing))}); {advice}")


def require_scene(item: Forest | FrameSet, scene_name: str, scene_hash: str, source: object) -> None:
    """Checks that a forest or frame set belongs to a scene; an imported forest fits any scene.

    UserError, which names the source, if it belongs to another scene, or to the same at another path depth.
    """
    if item.scene_hash in ("", scene_hash):
        return
    changed = "; the scene or its path depth has changed" if item.scene_name == scene_name else ""
    raise UserError(
        f"{source} belongs to scene {item.scene_name} ({item.scene_hash[:8]}), "
        f"not to {scene_name} ({scene_hash[:8]}){changed}"
    )
