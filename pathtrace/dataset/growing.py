"""A frame set that grows: further views, and further samples of those that it has, pass by pass."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import read_json, write_whole
from compose.camera.camera import RIGID_TOLERANCE, Camera
from compose.camera.coordinate_systems import camera_from_json, camera_to_json
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
from pathtrace.trace.traced_images import TracedImage, trace_frame
from pathtrace.trace.tracer import Tracer

# Between the seeds of views, of passes over one view, and of the two halves of a pass.
_VIEW_SEED_STEP, _PASS_SEED_STEP, _HALF_SEED_STEP = 1_009, 100_003, 1_000_033
# Fewer samples have no two halves.
LEAST_SPP = 2


@dataclass(frozen=True)
class Wanted:
    """A view of a growing frame set, at a time from 0 to 1, and its least samples per pixel, 2 or more."""

    camera: Camera
    spp: int
    time: float = 0.0


class GrowingFrames:
    """A frame set in a folder, which is complete after every call of `grow`; same calls, same frames.

    Every frame is the mean of two independent halves of its samples, denoised together; both are kept, and
    further samples are added to them. UserError if the folder holds other frames, or a damaged description.
    """

    def __init__(self, folder: Path, tracer: Tracer, integrator: str, seed: int):
        self.folder, self.scene, self._tracer, self._seed = folder, tracer.scene, tracer, seed
        self._path = folder / "transforms.json"
        self._facts = {"camera_model": "OPENCV", **described_set(tracer.scene, {"seed": seed}, integrator)}
        self._entries: list[dict[str, Any]] = self._stored()

    @property
    def samples(self) -> list[int]:
        """Samples per pixel of each view."""
        return [entry["samples"] for entry in self._entries]

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
        text = json.dumps({**self._facts, "frames": entries}, indent=1)
        write_whole(self._path, lambda part: part.write_text(text, encoding="utf-8"))
        # Files of earlier passes go.
        outdated = set(_files(self._entries)) - set(_files(entries))
        self._entries = entries
        for name in outdated:
            (self.folder / name).unlink(missing_ok=True)

    def _grown(self, index: int, view: Wanted, before: dict[str, Any] | None) -> dict[str, Any]:
        """Traces and writes what a view lacks; files of this pass that are there already are kept."""
        had = before["samples"] if before else 0
        number = before["passes"] + 1 if before else 1
        # Halves of equal size, for the estimate of their error.
        added = max(LEAST_SPP, view.spp - had + (view.spp - had) % 2)
        name = f"frames/{index:04d}-{number}"
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
        frame = framed(halves[0].mixed(halves[1], 0.5), *geometry)
        for file, half in zip(files, halves, strict=True):
            write_frame(file, half.radiance)
        # Last: a frame that is there has its halves.
        write_frame(self.folder / entry["file_path"], frame)
        return entry

    def _stored(self) -> list[dict[str, Any]]:
        if not self._path.is_file():
            (self.folder / "frames").mkdir(parents=True, exist_ok=True)
            return []
        try:
            document = read_json(self._path)
            entries = document.pop("frames")
            for entry in entries:
                # What cannot be read, or is not there, is an error.
                _ = camera_from_json(entry), entry["samples"] + entry["passes"], _files([entry])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{self._path}: is damaged ({error!r}); delete the folder") from error
        if {name: document.get(name) for name in self._facts} != json.loads(json.dumps(self._facts)):
            raise UserError(f"{self.folder}: holds other frames; choose another folder")
        return entries


def _is_same(stored: Camera, camera: Camera) -> bool:
    """Whether a camera was written and read as another, which may leave it a little less than rigid."""
    numbers = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in (stored, camera)]
    tolerance = np.full((4, 4), 2 * RIGID_TOLERANCE)
    tolerance[:3, 3] *= max(1.0, float(np.linalg.norm(camera.world_to_camera[:3, 3])))
    off = np.abs(stored.world_to_camera - camera.world_to_camera)
    return numbers[0] == numbers[1] and bool((off <= tolerance).all())


def _files(entries: list[dict[str, Any]]) -> list[str]:
    return [name for entry in entries for name in (entry["file_path"], *entry["halves"])]
