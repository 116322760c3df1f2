"""What other preparations of a scene have left in their folders, from which one can go on."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.base.cache_folder import scene_folder
from hybrid.base.identity import Journal
from pathtrace.scene.scene import Scene

# In the folder of a job: what is done, and its frames; in the journal, what it has from another job.
JOURNAL, FRAMES, TAKEN_OVER = "job.json", "frames", "taken over"


@dataclass(frozen=True)
class EarlierJob:
    """A preparation, finished or not."""

    folder: Path
    scene_hash: str
    region: dict[str, Any]  # identity of the region of its views
    stages: list[dict[str, Any]]  # whose frames are complete

    @property
    def place(self) -> Camera | None:
        """Near which its views are, if that is not where the scene's own camera is."""
        return Camera.of_key(bytes.fromhex(self.region["place"])) if "place" in self.region else None


def earlier_job(folder: Path) -> EarlierJob | None:
    """The preparation in a folder; None if there is none, or if its journal cannot be read."""
    with contextlib.suppress(UserError, KeyError, TypeError, ValueError, OverflowError):
        found = Journal.read(folder / JOURNAL)
        if found is not None:
            identity, results = found
            stages = list((results.get(TAKEN_OVER) or {"stages": []})["stages"])
            while f"frame seconds {len(stages)}" in results:
                stages.append(results[f"stage {len(stages)}"])
            job = EarlierJob(folder, identity["scene"], dict(identity["region"]), stages)
            _ = job.place
            return job
    return None


def newest_job(scene: Scene) -> EarlierJob | None:
    """The preparation of a scene that was the last one to trace frames; None if there is none."""
    times = {}
    for file in scene_folder(scene.name, scene.hash).glob(f"*/{FRAMES}/transforms.json"):
        with contextlib.suppress(OSError):
            times[file] = file.stat().st_mtime
    jobs = (earlier_job(file.parents[1]) for file in sorted(times, key=times.__getitem__, reverse=True))
    return next((job for job in jobs if job is not None), None)
