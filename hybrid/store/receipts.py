"""Receipts of captures: which frame sets were rendered with this cache folder, and do not only say so.

A scene's name and hash are no secret, so that any frame set can claim to show it. A forest becomes the newest
one of a scene, which commands use unasked, only if it was trained on frames with a receipt.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from compose.base.files import write_whole
from hybrid.store.cache import scene_folder
from pathtrace.dataset.frames import FrameSet


def keep_receipt(frames: FrameSet) -> None:
    """Notes that a frame set was captured here, as its files are now.

    Raises:
        UserError: the cache folder cannot be written.
    """
    text = f"{frames.folder.resolve()}\n"
    write_whole(_receipt(frames), lambda part: part.write_text(text))


def has_receipt(frames: FrameSet) -> bool:
    """Whether exactly these frames, wherever they lie now, were captured here."""
    return _receipt(frames).is_file()


def _receipt(frames: FrameSet) -> Path:
    return scene_folder(frames.scene_name, frames.scene_hash) / "receipts" / f"{_digest(frames)}.txt"


def _digest(frames: FrameSet) -> str:
    """Hash of a frame set's description and of all its files."""
    state = hashlib.sha256(frames.digest.encode())
    for entry in [*frames.entries, *frames.close_ups]:
        for file in (entry.file, *entry.estimates.values(), *entry.halves):
            # The description names the files, in this order.
            state.update(hashlib.sha256(file.read_bytes()).digest())
    return state.hexdigest()
