"""The cache folder (HYBRID_HOME, else the platform's): forests of scenes, and receipts of captures.

A scene's name and hash are no secret, so that any frame set can claim to show it. A forest becomes the newest
one of a scene, which commands use unasked, only if it was trained on frames with a receipt.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

import platformdirs

from compose.base.errors import UserError, claimed_scene
from compose.base.files import write_text
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.scene.scene import Scene
from splat.io.forest_file import save_forest, scene_of_forest
from splat.model.forest import Forest


def home() -> Path:
    """The cache folder; it may not exist yet."""
    if chosen := os.environ.get("HYBRID_HOME"):
        return Path(chosen)
    found = Path(platformdirs.user_cache_dir("hybrid"))
    # Of a user without a home, it would lie in a folder ~ of the working folder.
    return found if found.is_absolute() else Path(tempfile.gettempdir()) / f"hybrid-{os.getuid()}"


def scene_folder(name: str, digest: str) -> Path:
    """Folder of one version of a scene; UserError if name or hash cannot be those of a scene."""
    try:
        name, digest = claimed_scene(name, digest)
    except ValueError as error:
        raise UserError(str(error)) from error
    return home() / f"{name}-{digest[:12]}"


def store_forest(forest: Forest, name: str) -> None:
    """Stores a forest as NAME.safetensors, the newest one of its scene; UserError if it cannot be."""
    # The digits of a complete SHA-256.
    if len(forest.scene_hash) != 64:
        raise UserError(f"scene hash {forest.scene_hash!r}: only forests of a scene are stored")
    folder = scene_folder(forest.scene_name, forest.scene_hash) / "forests"
    save_forest(folder / f"{name}.safetensors", forest)


def newest_forest(scene: Scene) -> Path | None:
    """File of the forest that was stored last for a scene; None if there is none."""
    return newest_forest_of(scene.name, scene.hash)


def newest_forest_of(name: str, digest: str) -> Path | None:
    """File of the forest that was stored last for a scene with that name and hash; None if there is none.

    Files whose header is damaged or names another scene are skipped: the folder's name has only the first
    digits of the hash.
    """
    found = {}
    # Hidden files are still being written; another process may rename or remove them meanwhile.
    for path in (scene_folder(name, digest) / "forests").glob("[!.]*.safetensors"):
        with contextlib.suppress(FileNotFoundError):
            found[path] = path.stat().st_mtime
    for path in sorted(found, key=found.__getitem__, reverse=True):
        with contextlib.suppress(UserError):
            if scene_of_forest(path) == (name, digest):
                return path
    return None


def keep_receipt(frames: FrameSet) -> None:
    """Notes that a frame set was captured here, as its files are now; UserError if it cannot be noted."""
    write_text(_receipt(frames), f"{frames.folder.resolve()}\n")


def has_receipt(frames: FrameSet) -> bool:
    """Whether exactly these frames, wherever they lie now, were captured here."""
    return _receipt(frames).is_file()


def _receipt(frames: FrameSet) -> Path:
    """The file that is named by a hash of a frame set's description and of all its files."""
    state = hashlib.sha256(frames.digest.encode())
    for entry in frames.entries:
        # The description names the files, in this order.
        state.update(hashlib.sha256(entry.file.read_bytes()).digest())
    return scene_folder(frames.scene_name, frames.scene_hash) / "receipts" / f"{state.hexdigest()}.txt"
