"""Captures in parts, on many machines, the frame set that they become, and a forest trained on it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.base.files import read_json
from hybrid.base.cache_folder import has_receipt, keep_receipt, store_forest
from hybrid.base.identity import Journal, code, machine, short_hash
from hybrid.base.parts import Part, StoredPart, begin, first_come, parts_in, remove_parts, stored_parts
from hybrid.base.progress import Bars
from hybrid.preparation.decisions import FIXED_SAMPLES, LAYERS, SAMPLES, Value, planned_needs
from hybrid.preparation.forest_errors import HELD_OUT_SPP
from hybrid.preparation.forest_training import planned_settings, train
from hybrid.preparation.scene_plan import as_planned
from hybrid.preparation.stages import PreparationSettings
from hybrid.render.irradiance import cache_for, stored_cache
from pathtrace.dataset.capture import chosen_capture, join_shares, render_share
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet, read_frame_set
from pathtrace.region import NEAR
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from splat.model.forest import Forest

_DESCRIPTION = "transforms.json"


@dataclass(frozen=True)
class CaptureJob:
    """What parts make together.

    Attributes:
        settings: of the capture, but for the samples of training views.
        spp: these; those of the plan if None.
        integrator: of training views.
        override: items of the plan, by name.
        quality: of the forest that is trained on the frames (PreparationSettings); None if none is.
    """

    settings: CaptureSettings
    spp: int | None
    integrator: Integrator
    override: Mapping[str, Value]
    quality: str | None = None

    @property
    def kind(self) -> str:
        """Name of the command that makes it."""
        return "capture" if self.quality is None else "prepare"

    def asked(self) -> dict[str, Any]:
        """What must be the same for all parts, in types that JSON has."""
        settings = {**asdict(self.settings), "spp": self.spp}
        asked = {"settings": settings, "integrator": self.integrator.value, "override": dict(self.override)}
        return asked if self.quality is None else {**asked, "quality": self.quality}


def preparation_job(settings: PreparationSettings, override: Mapping[str, Value]) -> CaptureJob:
    """The capture of as many views and samples as the stages of a quality have, all at the finest resolution.

    UserError for settings that parts cannot have.
    """
    if settings.minutes is not None or settings.psnr is not None:
        raise UserError("part: takes --quality, and neither --minutes nor --psnr")
    if settings.region != NEAR:
        raise UserError(f"region {settings.region}: parts prepare the region {NEAR} only")
    for name in ("size", "most_indirect"):
        if getattr(settings, name) != getattr(PreparationSettings, name):
            raise UserError(f"{name}: has no influence on parts; leave it out")
    stages = settings.stages
    side, spp = stages[-1].whole, stages[-1].spp
    views = sum(stage.views for stage in stages)
    frames = CaptureSettings(views, settings.held_out, side, side, spp, HELD_OUT_SPP, settings.seed)
    return CaptureJob(frames, spp, Integrator.CACHED, override, settings.quality)


def capture_part(scene: Scene, shared: Path, part: Part, job: CaptureJob, bars: Bars) -> StoredPart:
    """Renders the frames of one part of a job, into a folder of its own; resumes if interrupted.

    All parts have the plan, the views and the irradiance cache of the one that comes first. UserError as
    `begin` and `capture` raise it, or if the folder holds a whole capture, or a forest is to be trained of a
    scene that moves.
    """
    if (shared / _DESCRIPTION).exists():
        raise UserError(f"{shared}: holds a whole capture already; name another folder")
    if job.quality is not None and scene.moving is not None:
        raise UserError(f"{scene.name}: something moves in it; prepare it on one machine, without --part")
    settings, integrator = job.settings, job.integrator
    identity = {"scene": scene.hash, **job.asked(), "code": code(), "machine": machine()}
    stored = begin(shared, job.kind, part, identity)
    with first_come(shared) as common:
        journal = Journal(common / "capture.json", stored.identity)
        plan = journal.once("plan", lambda: dict(as_planned(scene, bars, job.override).plan))
        scene = scene.planned(plan) if plan else scene
        settings = replace(settings, spp=job.spp or plan.get(SAMPLES, FIXED_SAMPLES))
        document = journal.once("views", lambda: chosen_capture(scene, settings, integrator))
        file, cache = common / "irradiance.safetensors", None
        if integrator is Integrator.CACHED:
            cache = stored_cache(file, lambda: cache_for(scene, bars))
        irradiance = hashlib.sha256(file.read_bytes()).hexdigest() if cache else None
    with bars(f"capture, {part} (samples)") as bar:
        render_share(scene, stored.folder, document, bar, cache, part.takes)
    stored.finish(views=short_hash(document), irradiance=irradiance)
    return stored


def merge_capture(shared: Path) -> FrameSet:
    """Makes the frame set of all parts of a capture, in their shared folder, with a receipt.

    If interrupted, it goes on. UserError, before anything is moved, as `parts_in` raises it.
    """
    parts, frames = _joined(shared)
    remove_parts(shared, parts)
    return frames


def merge_preparation(shared: Path, bars: Bars) -> tuple[FrameSet, Forest]:
    """As `merge_capture`, and trains a forest on the frames, which becomes the newest one of its scene.

    It is the file `forest.safetensors` in the shared folder.
    """
    parts, frames = _joined(shared)
    stages = PreparationSettings(quality=parts[0].identity["quality"]).stages
    finest = stages[-1].for_needs(planned_needs(frames.plan, NEAR, 1.0))
    settings = planned_settings(
        frames,
        iterations=sum(stage.steps for stage in stages),
        gaussians=finest.gaussians,
        layers=min(finest.layers, frames.plan.get(LAYERS, finest.layers)),
        seed=parts[0].identity["settings"]["seed"],
    )
    path = shared / "forest.safetensors"
    with bars("forest (steps)") as bar:
        forest = train(frames, path, settings, bar)
    store_forest(forest, path.stem)
    # Until now, they say what is to be trained.
    remove_parts(shared, parts)
    return frames, forest


def _joined(shared: Path) -> tuple[list[StoredPart], FrameSet]:
    """All parts of a job and their frame set, with a receipt; the parts' folders are still there."""
    if (shared / _DESCRIPTION).is_file():
        # Joined before; perhaps interrupted while parts were removed.
        parts, frames = stored_parts(shared), read_frame_set(shared)
        if not parts and not has_receipt(frames):
            raise UserError(f"{shared}: a frame set without parts, and not captured here")
        views = short_hash(read_json(shared / _DESCRIPTION))
        if any(one.identity.get("views") != views for one in parts):
            raise UserError(f"{shared}: holds another capture than its parts; name another folder for them")
    else:
        parts = parts_in(shared)
        frames = join_shares(shared, [one.folder for one in parts])
    keep_receipt(frames)
    return parts, frames
