"""Captures in parts, on many machines, and the frame set that they become."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

from compose.base.errors import UserError
from compose.base.files import read_json
from hybrid.base.cache_folder import has_receipt, keep_receipt
from hybrid.base.identity import Journal, code, machine, short_hash
from hybrid.base.parts import Part, StoredPart, begin, first_come, parts_in, remove_parts, stored_parts
from hybrid.base.progress import Bars
from hybrid.preparation.decisions import FIXED_SAMPLES, SAMPLES, Value
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.irradiance import cache_for, stored_cache
from pathtrace.dataset.capture import chosen_capture, join_shares, render_share
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet, read_frame_set
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator

_DESCRIPTION = "transforms.json"


def capture_part(
    scene: Scene,
    shared: Path,
    part: Part,
    settings: CaptureSettings,
    spp: int | None,
    integrator: Integrator,
    override: Mapping[str, Value],
    bars: Bars,
) -> StoredPart:
    """Renders the frames of one part of a capture, into a folder of its own; resumes if interrupted.

    All parts have the plan, with items overridden, the views and the irradiance cache of the one that comes
    first. Training views have `spp` samples in place of those of the settings, those of the plan if None.
    UserError as `begin` and `capture` raise it, or if the folder holds a whole capture.
    """
    if (shared / _DESCRIPTION).exists():
        raise UserError(f"{shared}: holds a whole capture already; name another folder")
    asked = {"settings": {**asdict(settings), "spp": spp}, "integrator": integrator.value}
    identity = {"scene": scene.hash, **asked, "override": dict(override)}
    stored = begin(shared, "capture", part, {**identity, "code": code(), "machine": machine()})
    with first_come(shared) as common:
        journal = Journal(common / "capture.json", stored.identity)
        plan = journal.once("plan", lambda: dict(as_planned(scene, bars, override).plan))
        scene = scene.planned(plan) if plan else scene
        settings = replace(settings, spp=spp or plan.get(SAMPLES, FIXED_SAMPLES))
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
    remove_parts(shared, parts)
    return frames
