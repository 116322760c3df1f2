"""Identities of cached results, and journals of them: different inputs, code or machines are never mixed."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import zlib
from collections import UserDict
from collections.abc import Callable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import mitsuba as mi

from compose.base.errors import UserError, one_line
from compose.base.files import locked, read_json, write_text

if TYPE_CHECKING:
    from pathtrace.dataset.frame_set import FrameSet
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest

T = TypeVar("T")
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


def measured_identity(scene: Scene, forest: Forest, **settings: object) -> dict[str, Any]:
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


_CHECKSUM = "crc32"
# More than the results of thousands of evaluations.
_MOST_BYTES = 1 << 30


class Journal(UserDict[str, Any]):
    """Named results so far in one JSON file, from which work resumes; each is saved at once.

    The identity is everything that the results depend on, in types that JSON has. UserError if the file is
    damaged, or belongs to another identity.
    """

    def __init__(self, path: Path, identity: dict[str, Any]):
        self._path = path
        self._identity = identity
        self.data = self._stored()

    def once(self, name: str, make: Callable[[], T]) -> T:
        """The result with that name; computed and saved if there is none yet."""
        if name not in self:
            self[name] = make()
        found: T = self[name]
        return found

    def __setitem__(self, name: str, result: object) -> None:
        self.data[name] = result
        self.write()

    def remove(self) -> None:
        """Deletes the file when the work is complete."""
        self._path.unlink(missing_ok=True)

    def write(self) -> None:
        """Saves all results, beside those that another process saved meanwhile.

        Needed only after a result was changed in place. UserError if the file cannot be written, is damaged,
        or belongs to another identity by now.
        """
        content = {"identity": self._identity, "results": self.data}
        # What JSON cannot hold is noticed before anything is touched.
        json.dumps(content)
        try:
            with locked(self._path.parent):
                self.data |= {n: r for n, r in self._stored().items() if n not in self.data}
                text = json.dumps({**content, _CHECKSUM: _checksum(content)}) + "\n"
                write_text(self._path, text)
        except OSError as error:
            raise UserError(f"{self._path}: cannot be written ({error.strerror})") from error

    @staticmethod
    def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Identity and results of a journal, whatever it belongs to; None if there is none.

        UserError if the file is damaged.
        """
        try:
            # Python writes infinities, such as the PSNR of equal images.
            found = read_json(path, _MOST_BYTES, finite=False)
            identity, results = dict(found["identity"]), dict(found["results"])
            if found.pop(_CHECKSUM, None) not in (None, _checksum(found)):
                raise ValueError("the checksum differs")
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(
                f"{path}: is damaged ({one_line(repr(error))}); delete it to start again"
            ) from error
        return identity, results

    def _stored(self) -> dict[str, Any]:
        """The results in the file; empty if there is none."""
        found = self.read(self._path)
        if found is None:
            return {}
        theirs, results = found
        what, advice = f"{self._path.parent}: holds results", "choose another folder"
        require_same(theirs, self._identity, what, advice)
        return results


def _checksum(content: dict[str, Any]) -> str:
    """Eight hexadecimal digits of what JSON says of a content."""
    return f"{zlib.crc32(json.dumps(content, sort_keys=True).encode()):08x}"
