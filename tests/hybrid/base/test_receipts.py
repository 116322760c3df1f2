"""Which frame sets were captured here."""

from __future__ import annotations

import shutil

import pytest

from hybrid.base.cache_folder import has_receipt, keep_receipt
from pathtrace.dataset.frame_set import read_frame_set

pytestmark = pytest.mark.usefixtures("own_home")


def test_frames_without_a_receipt_were_not_captured_here(made, monkeypatch):
    frames = read_frame_set(made / "frames")
    assert not has_receipt(frames)
    # The command that captured them kept one.
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    assert has_receipt(frames)


def test_a_receipt_is_of_the_files_and_not_of_their_folder(made, tmp_path):
    keep_receipt(read_frame_set(made / "frames"))
    copy = tmp_path / "copy"
    shutil.copytree(made / "frames", copy)
    assert has_receipt(read_frame_set(copy))


@pytest.mark.parametrize("kind", ["file", "estimates", "halves"])
def test_a_receipt_does_not_fit_other_files(made, tmp_path, kind):
    keep_receipt(read_frame_set(made / "frames"))
    copy = tmp_path / "copy"
    shutil.copytree(made / "frames", copy)
    frames = read_frame_set(copy)
    entry = next(entry for entry in frames.entries if entry.halves)
    changed = {
        "file": entry.file,
        "estimates": next(iter(entry.estimates.values())),
        "halves": entry.halves[0],
    }
    changed[kind].write_bytes(changed[kind].read_bytes() + b"\0")
    assert not has_receipt(read_frame_set(copy))
