"""A frame set that grows: further views, and further samples of those that it has, pass by pass."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import read_json, write_whole
from compose.camera.camera import RIGID_TOLERANCE, Camera
from compose.camera.coordinate_systems import Place, camera_from_json, camera_to_json
from compose.image.colour import Image
from pathtrace.dataset.capture import described_set
from pathtrace.dataset.captured_frames import (
    CapturedFrame,
    framed,
    geometry_of,
    is_intact,
    read_frame,
    read_radiance,
    write_frame,
)
from pathtrace.dataset.changed_frames import SeenAgain, can_be_seen_again, seen_again
from pathtrace.trace.traced_images import TracedImage, trace_frame
from pathtrace.trace.tracer import Tracer

# Between the seeds of views, of passes over one view, and of the two halves of a pass.
_VIEW_SEED_STEP, _PASS_SEED_STEP, _HALF_SEED_STEP = 1_009, 100_003, 1_000_033
_FRAMES = "frames"
# Fewer samples have no two halves.
LEAST_SPP = 2
# Frames that tell whether it pays to look at all, and the share of them that may have changed. Seeds of what
# is looked at are apart from those of passes.
_ASKED, _MOST_CHANGED, _AGAIN_SEED = 6, 0.7, 500_000_003


@dataclass(frozen=True)
class Wanted:
    """A view of a growing frame set, at a time from 0 to 1, and its least samples per pixel, 2 or more."""

    camera: Camera
    spp: int
    time: float = 0.0


class StoredFrames:
    """A frame set that has grown in a folder, to read; UserError if its description is damaged."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._path = folder / "transforms.json"
        self._described, self._entries = self._stored()

    @property
    def samples(self) -> list[int]:
        """Samples per pixel of each view."""
        return [entry["samples"] for entry in self._entries]

    def spread(self, count: int) -> list[int]:
        """Numbers of at most so many views, evenly spaced over all."""
        last = len(self._entries) - 1
        return sorted({round(at) for at in np.linspace(0, last, count)} if last >= 0 else ())

    def time(self, view: int) -> float:
        """The time that a view shows."""
        return float(self._entries[view]["time"])

    def camera(self, view: int) -> Camera:
        """The camera of a view."""
        return camera_from_json(self._entries[view])

    def radiance(self, view: int) -> Image:
        """(H, W, 3) denoised radiance of a view."""
        return self._stored_frame(self._entries[view]).radiance

    def halves(self, view: int) -> tuple[TracedImage, TracedImage]:
        """The two independent halves of a view's samples, each with the features of both."""
        entry = self._entries[view]
        one, other = self._halves(entry, self._stored_frame(entry))
        return one, other

    def _halves(self, entry: dict[str, Any], frame: CapturedFrame) -> list[TracedImage]:
        halves = (read_radiance(self.folder / name, frame.depth.shape[::-1]) for name in entry["halves"])
        return [TracedImage(half, frame.albedo, frame.normal) for half in halves]

    def _stored_frame(self, entry: dict[str, Any]) -> CapturedFrame:
        camera = camera_from_json(entry)
        return read_frame(self.folder / entry["file_path"], (camera.width, camera.height))

    def _stored(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """What the description says of all frames, and of each."""
        if not self._path.is_file():
            return {}, []
        try:
            document = read_json(self._path)
            entries = document.pop("frames")
            for entry in entries:
                # What cannot be read, or is not there, is an error.
                _ = camera_from_json(entry), entry["samples"] + entry["passes"], _files([entry])
            _ = document["scene"]["hash"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{self._path}: is damaged ({error!r}); delete the folder") from error
        return document, entries


class GrowingFrames(StoredFrames):
    """A frame set in a folder, which is complete after every call of `grow`; same calls, same frames.

    Every frame is the mean of two independent halves of its samples, denoised together; both are kept, and
    further samples are added to them. UserError if the folder holds other frames, or a damaged description.
    """

    def __init__(self, folder: Path, tracer: Tracer, integrator: str, seed: int):
        super().__init__(folder)
        self.scene, self._tracer, self._seed = tracer.scene, tracer, seed
        self._facts = {"camera_model": "OPENCV", **described_set(tracer.scene, {"seed": seed}, integrator)}
        found = {name: self._described.get(name) for name in self._facts}
        if self._described and found != json.loads(json.dumps(self._facts)):
            raise UserError(f"{self.folder}: holds other frames; choose another folder")
        (folder / _FRAMES).mkdir(parents=True, exist_ok=True)

    def grow(self, wanted: Sequence[Wanted], progress: Callable[[int, int], None]) -> None:
        """Adds the views that are not there yet, and the samples that views lack.

        All views are wanted: those that are there, in their order, and then new ones; else ValueError. After
        each view, progress is told the samples done and their total. UserError if a file is damaged or not
        writable.
        """
        pairs = zip(self._entries, wanted, strict=False)
        same = (_is_same(camera_from_json(e), v.camera) and e["time"] == v.time for e, v in pairs)
        new = len(wanted) - len(self._entries)
        if new < 0 or not all(same):
            raise ValueError("views of a frame set that grows must stay as they are")
        had = [*self.samples, *[0] * new]
        costs = [
            max(0, view.spp - have) * view.camera.width * view.camera.height
            for view, have in zip(wanted, had, strict=True)
        ]
        entries = self._entries.copy()
        for index, view in enumerate(wanted):
            if costs[index]:
                before = self._entries[index] if had[index] else None
                entries[index : index + 1] = [self._grown(index, view, before)]
                progress(sum(costs[: index + 1]), sum(costs))
        self._write(entries)

    def _write(self, entries: list[dict[str, Any]]) -> None:
        text = json.dumps({**self._facts, "frames": entries}, indent=1)
        write_whole(self._path, lambda part: part.write_text(text, encoding="utf-8"))
        # Files of earlier passes go.
        outdated = set(_files(self._entries)) - set(_files(entries))
        self._entries = entries
        for name in outdated:
            (self.folder / name).unlink(missing_ok=True)

    def take_over(self, before: StoredFrames, count: int, progress: Callable[[int, int], None]) -> bool:
        """Begins with the first frames of the same scene, before it was changed if it was.

        What has changed in them is traced anew, with as many samples. False if that is most of them, or if
        there are fewer than `count`. The other set stays as it is, and must not grow meanwhile. After each
        view, progress is told the views done and their number. ValueError if there are frames already.
        UserError if a file is damaged or not writable.
        """
        if self._entries:
            raise ValueError("there are frames already")
        taken = False
        try:
            self._clear()
            taken = len(before.samples) >= count and self._take_over(before, count, progress)
        finally:
            if not taken:
                # They would be taken for what an interrupted pass has left.
                self._clear()
        return taken

    def _clear(self) -> None:
        for file in (self.folder / _FRAMES).iterdir():
            file.unlink()

    def _take_over(self, before: StoredFrames, count: int, progress: Callable[[int, int], None]) -> bool:
        entries, is_same = before._entries[:count], before._described["scene"]["hash"] == self.scene.hash
        if not is_same and not self._is_alike(before):
            return False
        for number, entry in enumerate(entries):
            seen = None if is_same else self._seen_again(before, number)
            if seen is None or not seen.tiles.any():
                for name in _files([entry]):
                    _link(self.folder / name, before.folder / name)
            else:
                self._write_view(entry, *self._renewed(number, before, seen))
            progress(number + 1, len(entries))
        self._write(entries)
        return True

    def _is_alike(self, before: StoredFrames) -> bool:
        """Whether so little has changed in frames of before that it pays to look at each."""
        cameras = [before.camera(number) for number in range(len(before.samples))]
        if self.scene.moving is not None or not all(map(can_be_seen_again, cameras)):
            return False
        if _place(before._described) != _place(self._facts):
            return False
        changed = [self._seen_again(before, number).share for number in before.spread(_ASKED)]
        return float(np.mean(changed)) <= _MOST_CHANGED

    def _seen_again(self, before: StoredFrames, number: int) -> SeenAgain:
        frame = before._stored_frame(before._entries[number])
        seed = (self._seed + _AGAIN_SEED + number) % 2**32
        return seen_again(self._tracer, before.camera(number), frame, seed)

    def _renewed(
        self, number: int, before: StoredFrames, seen: SeenAgain
    ) -> tuple[list[TracedImage], CapturedFrame]:
        """A view's halves and frame, in which what has changed is traced anew."""
        seed = self._seed * _VIEW_SEED_STEP * _HALF_SEED_STEP + number * _VIEW_SEED_STEP + _AGAIN_SEED
        halves = [
            seen.traced(self._tracer, half, before.samples[number] // 2, (seed + step) % 2**32)
            for half, step in zip(before.halves(number), (0, _HALF_SEED_STEP), strict=True)
        ]
        return halves, seen.framed(self._tracer, before.radiance(number), halves[0].mixed(halves[1], 0.5))

    def _grown(self, index: int, view: Wanted, before: dict[str, Any] | None) -> dict[str, Any]:
        """Traces and writes what a view lacks; files of this pass that are there already are kept."""
        had = before["samples"] if before else 0
        number = before["passes"] + 1 if before else 1
        # Halves of equal size, for the estimate of their error.
        added = max(LEAST_SPP, view.spp - had + (view.spp - had) % 2)
        name = f"{_FRAMES}/{index:04d}-{number}"
        entry = {
            "file_path": f"{name}.exr",
            **camera_to_json(view.camera),
            "time": view.time,
            "samples": had + added,
            "passes": number,
            "held_out": False,
            "halves": [f"{name}-half{half}.exr" for half in (1, 2)],
        }
        files = [self.folder / half for half in entry["halves"]]
        # An interrupted pass came as far as this view if its frame, written last, is intact.
        if is_intact(read_frame, self.folder / entry["file_path"], view.camera) and all(
            is_intact(read_radiance, file, view.camera) for file in files
        ):
            return entry
        self.scene.show(view.time)
        seed = self._seed * _VIEW_SEED_STEP * _HALF_SEED_STEP + index * _VIEW_SEED_STEP
        seed += number * _PASS_SEED_STEP
        halves = [
            trace_frame(self._tracer, view.camera, added // 2, (seed + half) % 2**32)
            for half in (0, _HALF_SEED_STEP)
        ]
        earlier = self._stored_frame(before) if before else None
        if before and earlier:
            known = had / (had + added)
            pairs = zip(self._halves(before, earlier), halves, strict=True)
            halves = [old.mixed(new, known) for old, new in pairs]
            geometry = earlier.depth, earlier.unfolded, earlier.shape
        else:
            geometry = geometry_of(self._tracer, view.camera)
        self._write_view(entry, halves, framed(halves[0].mixed(halves[1], 0.5), *geometry))
        return entry

    def _write_view(self, entry: dict[str, Any], halves: Sequence[TracedImage], frame: CapturedFrame) -> None:
        for name, half in zip(entry["halves"], halves, strict=True):
            write_frame(self.folder / name, half.radiance)
        # Last: a frame that is there has its halves.
        write_frame(self.folder / entry["file_path"], frame)


def _is_same(stored: Camera, camera: Camera) -> bool:
    """Whether a camera was written and read as another, which may leave it a little less than rigid."""
    numbers = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in (stored, camera)]
    tolerance = np.full((4, 4), 2 * RIGID_TOLERANCE)
    tolerance[:3, 3] *= max(1.0, float(np.linalg.norm(camera.world_to_camera[:3, 3])))
    off = np.abs(stored.world_to_camera - camera.world_to_camera)
    return numbers[0] == numbers[1] and bool((off <= tolerance).all())


def _place(described: dict[str, Any]) -> str:
    """JSON of a frame set's coordinates, by its description."""
    return json.dumps([described["scene"].get(part.name) for part in fields(Place)])


def _link(link: Path, file: Path) -> None:
    """Gives a file a second name, which stays when the first one goes; or copies it, where that is all."""
    try:
        os.link(file, link)
    except OSError:
        write_whole(link, lambda part: shutil.copyfile(file, part))


def _files(entries: list[dict[str, Any]]) -> list[str]:
    return [name for entry in entries for name in (entry["file_path"], *entry["halves"])]
