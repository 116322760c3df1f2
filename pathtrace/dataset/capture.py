"""Captures a frame set: views chosen in free space, traced, denoised, written one by one.

Which frames there are, and how each is rendered, stands in transforms.json. Its names follow the Nerfstudio /
instant-ngp convention, so that other programs can read the file.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import read_json, write_whole
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import WORLD, camera_from_json, camera_to_json
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.dataset.captured_frames import (
    is_intact,
    read_estimate,
    read_frame,
    read_radiance,
    render_estimates,
    render_frame,
    render_with_halves,
    write_frame,
)
from pathtrace.dataset.frame_set import FORMAT_VERSION, CaptureSettings, FrameSet, read_frame_set
from pathtrace.region.neighbourhood import ViewSet, choose_views, monocular_views
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.tracer import Tracer

_DESCRIPTION = "transforms.json"
# Keeps the seeds of different captures apart: far more than one capture has frames.
_CAPTURE_SEED_STEP = 100_003
# Samples per pixel of the estimates stored with some held-out views: what a fovea may be traced with.
_ESTIMATE_SPP = (1, 2, 4, 16, 64)


def describe_capture(
    scene: Scene, views: ViewSet, settings: CaptureSettings, integrator: Integrator
) -> dict[str, Any]:
    """The content of transforms.json, for an integrator of all but held-out frames, which are unbiased.

    UserError if more views are held out than may be.
    """
    cameras, count, most = views.fixed + views.spread, settings.held_out, len(views.spread)
    if count > most:
        raise UserError(f"held-out {count}: must be at most {most}, the views that may be held out")
    step = most / max(1, count)
    held_out = {len(views.fixed) + round((i + 1) * step) - 1 for i in range(count)}
    # Every third held-out view is kept from fitting the fusion, too.
    fitted = {index for number, index in enumerate(sorted(held_out)) if number % 3 != 2}
    spp = settings.held_out_spp
    # Samples per pixel of a view's estimates, in all at most half of the view's own.
    estimates = [n for i, n in enumerate(_ESTIMATE_SPP) if 2 * sum(_ESTIMATE_SPP[: i + 1]) <= spp]
    frames = [
        _entry(
            camera,
            f"frames/{index:04d}",
            spp if index in held_out else settings.spp,
            estimates if index in fitted else [],
            index in held_out,
            views.times[index],
        )
        for index, camera in enumerate(cameras)
    ]
    described = {**asdict(settings), "close_ups": list(settings.close_ups)}
    if not settings.monocular:
        # As captures had them when there were no other views.
        del described["monocular"]
    rng = np.random.default_rng(settings.seed)
    close_ups = []
    for index, factor in itertools.product(sorted(fitted), settings.close_ups):
        part, path = _part_of(cameras[index], factor, rng), f"frames/{index:04d}-closer{factor}"
        entry = _entry(part, path, spp, estimates, True, views.times[index])
        # With its own intrinsics.
        close_ups.append({**entry, **camera_to_json(part)})
    intrinsics = camera_to_json(cameras[0])
    del intrinsics["transform_matrix"]
    return {
        "camera_model": "OPENCV",
        **intrinsics,
        **described_set(scene, described, integrator.value),
        "frames": frames,
        # Not among the frames, all of which other programs would train on.
        "close_ups": close_ups,
    }


def described_set(scene: Scene, settings: dict[str, Any], integrator: str) -> dict[str, Any]:
    """What transforms.json says of all frames: of their scene, what moves in it, and how it is traced."""
    place = {} if scene.place == WORLD else asdict(scene.place)
    plan = {"plan": dict(scene.plan)} if scene.plan else {}
    motion = {} if scene.moving is None else {"courses": [c.as_json() for c in scene.moving.courses()]}
    return {
        "format_version": FORMAT_VERSION,
        "scene": {"name": scene.name, "hash": scene.hash, "max_depth": scene.max_depth, **place, **plan},
        "settings": settings,
        "integrator": integrator,
        **motion,
    }


def write_description(folder: Path, document: dict[str, Any]) -> None:
    """Writes transforms.json and makes the folder of the frames; keeps an equal file, refuses others."""
    path = folder / _DESCRIPTION
    text = json.dumps(document, indent=1)
    if not path.is_file():
        write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))
        # Whoever writes a frame says what is wrong there.
        with contextlib.suppress(OSError):
            (folder / "frames").mkdir(exist_ok=True)
        return
    try:
        found = read_json(path)
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: is damaged ({error}); delete it and capture with the same settings again"
        ) from error
    if found != json.loads(text):
        raise UserError(f"{folder}: holds another capture; choose another folder or the same settings")


def _entry(
    camera: Camera, path: str, spp: int, estimate_spp: list[int], held_out: bool, time: float
) -> dict[str, Any]:
    """A frame of transforms.json; `path` has no extension."""
    return {
        "file_path": f"{path}.exr",
        "transform_matrix": camera_to_json(camera)["transform_matrix"],
        "time": time,
        "samples": spp,
        "held_out": held_out,
        "estimates": [{"samples": count, "file_path": f"{path}-{count}spp.exr"} for count in estimate_spp],
        "halves": [f"{path}-half{number}.exr" for number in (1, 2)] if estimate_spp else [],
    }


def _part_of(camera: Camera, factor: int, rng: np.random.Generator) -> Camera:
    """A random part of a view at a multiple of its resolution, half as many pixels wide and high."""
    large = camera.resized(camera.width * factor, camera.height * factor)
    width, height = max(1, camera.width // 2), max(1, camera.height // 2)
    left, top = int(rng.integers(large.width - width + 1)), int(rng.integers(large.height - height + 1))
    return large.cropped(left, top, width, height)


def capture(
    scene: Scene,
    folder: Path,
    settings: CaptureSettings,
    progress: Callable[[int, int], None],
    cache: IrradianceCache | None = None,
) -> FrameSet:
    """Captures a frame set of a scene to train on, into a folder; resumes if it was interrupted.

    Views lie in free space around the scene's own camera, which is the first of them. The held-out ones are
    spaced evenly over the others, and unbiased. Two of three also have estimates, traced with fewer samples,
    two independent halves of their own samples, and close-ups at two and four times the resolution: what the
    fusion is fitted to. Of a scene that moves, views have times of their own; a monocular capture is that of
    one camera, which sways around the scene's own.

    The folder gets a `transforms.json` and one OpenEXR file per frame, estimate and close-up. Intact files
    are not rendered again; a resumed capture ends with the same files as one that was not interrupted.

    Args:
        scene, folder, settings: what is captured, where to, and how.
        progress: called after each frame with the number of samples done and their total.
        cache: in which the paths of training frames, estimates and close-ups end; without it, these are
            unbiased as well.

    Raises:
        UserError: the folder holds another capture or cannot be written; the scene's own camera sees no
            surface; there is no free space for that many views; or more views are held out than may be.

    Examples:
        >>> settings = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
        >>> frames = capture(load_scene("room"), Path("frames"), settings, lambda done, total: None)
        >>> len(frames.training), len(frames.held_out)
        (40, 4)
    """
    integrator = Integrator.PATH if cache is None else Integrator.CACHED
    render_share(scene, folder, chosen_capture(scene, settings, integrator), progress, cache)
    return read_frame_set(folder)


def chosen_capture(scene: Scene, settings: CaptureSettings, integrator: Integrator) -> dict[str, Any]:
    """As `describe_capture`, of views chosen as `capture` does; raises as it does."""
    count = settings.views + settings.held_out
    # The free space is that of the beginning, whatever the scene has shown last.
    scene.show(0.0)
    size, surfaces = (settings.width, settings.height), scene.surfaces()
    if settings.monocular:
        views = monocular_views(scene, surfaces, count, *size)
    else:
        views = choose_views(scene, surfaces, count, *size, settings.seed)
    return describe_capture(scene, views, settings, integrator)


def render_share(
    scene: Scene,
    folder: Path,
    document: dict[str, Any],
    progress: Callable[[int, int], None],
    cache: IrradianceCache | None = None,
    takes: Callable[[int], bool] = lambda number: True,
) -> None:
    """Renders the frames of a described capture that `takes` wants, by their number from the most costly.

    They are the same, whatever else is rendered. Progress counts their samples; raises as `capture` does.
    """
    write_description(folder, document)
    unbiased, quick = Tracer(scene), Tracer(scene, cache=cache)
    entries = document["frames"] + document["close_ups"]
    cameras = [camera_from_json({**document, **entry}) for entry in entries]
    samples = [
        (entry["samples"] + sum(e["samples"] for e in entry["estimates"])) * camera.width * camera.height
        for entry, camera in zip(entries, cameras, strict=True)
    ]
    # Held-out frames cost most and come at regular intervals: by index, one share might get them all.
    by_cost = sorted(range(len(entries)), key=lambda index: -samples[index])
    share = sorted(index for number, index in enumerate(by_cost) if takes(number))
    done, total = 0, sum(samples[index] for index in share)
    for index in share:
        entry, camera = entries[index], cameras[index]
        # Each frame has a seed of its own, so that a resumed capture ends with the same frames.
        seed = document["settings"]["seed"] * _CAPTURE_SEED_STEP + index
        measures = entry["held_out"] and index < len(document["frames"])
        scene.show(entry["time"])
        files = {e["samples"]: folder / e["file_path"] for e in entry["estimates"]}
        lacking = {spp: file for spp, file in files.items() if not is_intact(read_estimate, file, camera)}
        estimates = render_estimates(quick, camera, tuple(files), seed, lacking)
        for file, estimate in zip(lacking.values(), estimates, strict=True):
            write_frame(file, estimate)
        _write_frame(unbiased if measures else quick, folder, entry, camera, seed)
        done += samples[index]
        progress(done, total)


def join_shares(folder: Path, shares: Sequence[Path]) -> FrameSet:
    """Makes a frame set of the folders of all shares of one capture, whose files move into it.

    If interrupted, it goes on. UserError, before anything is moved, if the shares are of different captures,
    or a file is missing.
    """
    text = (shares[0] / _DESCRIPTION).read_text(encoding="utf-8")
    for share in shares:
        if (share / _DESCRIPTION).read_text(encoding="utf-8") != text:
            raise UserError(f"{share}: holds another capture than {shares[0]}")
    document = json.loads(text)
    names = [
        name
        for entry in document["frames"] + document["close_ups"]
        for name in (entry["file_path"], *(e["file_path"] for e in entry["estimates"]), *entry["halves"])
    ]
    places = {name: place for place in (*shares, folder) for name in names if (place / name).is_file()}
    if missing := [name for name in names if name not in places]:
        raise UserError(
            f"{folder}: {len(missing)} of {len(names)} files are in no part ({missing[0]} first); "
            "run the parts again"
        )
    (folder / "frames").mkdir(exist_ok=True)
    for name, place in places.items():
        if place != folder:
            os.replace(place / name, folder / name)
    # Last: a folder without it is no frame set.
    write_description(folder, document)
    return read_frame_set(folder)


def _write_frame(tracer: Tracer, folder: Path, entry: dict[str, Any], camera: Camera, seed: int) -> None:
    file, halves = folder / entry["file_path"], [folder / name for name in entry["halves"]]
    lacking = [half for half in halves if not is_intact(read_radiance, half, camera)]
    has_frame = is_intact(read_frame, file, camera)
    if has_frame and not lacking:
        return
    if halves:
        frame, radiances = render_with_halves(tracer, camera, entry["samples"], seed)
        for half, radiance in zip(halves, radiances, strict=True):
            if half in lacking:
                write_frame(half, radiance)
    else:
        frame = render_frame(tracer, camera, entry["samples"], seed)
    if not has_frame:
        write_frame(file, frame)
