"""`hybrid merge`, and what commands with --part and --ray have in common."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError, one_line
from hybrid.cli import options as o
from hybrid.cli.progress import messages_as_lines, progress_bar

if TYPE_CHECKING:
    from hybrid.base.parts import Part, StoredPart

# How often a part is begun again whose worker died, such as one whose machine was taken away.
_RETRIES = 5
# Of these options, each part gets its own or none.
_NOT_OF_PARTS = ("--part", "--ray", "--json")


def chosen_part(text: str | None) -> Part | None:
    """The part that `--part` asks for; None without it."""
    from hybrid.base.parts import part_named

    with o.option_names("part"):
        if text is not None and text.startswith("all/"):
            raise UserError(f"part {text}: all parts at once require --ray")
        return None if text is None else part_named(text)


def said_part(stored: StoredPart) -> None:
    """Says what comes after a part."""
    print(f"{stored.part} in {stored.folder}; when all are there: hybrid merge {stored.folder.parent}")


def merge(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder that parts of a job share.")],
) -> o.Measured:
    """Join the parts that a command with --part made, if all are there, finished and of one version.

    Parts of a capture become a frame set in the folder, those of a preparation also a forest, those of an
    evaluation its page. Those of a sweep stay as they are, and --json writes the whole.
    """
    from hybrid.base.parts import stored_parts

    # A capture that is merged has no parts any more: doing it again does no harm.
    kind = next((one.kind for one in stored_parts(folder)), "capture")
    if kind not in _MERGES:
        raise UserError(f"{folder}: holds parts of {one_line(kind)}, which this version cannot merge")
    return _MERGES[kind](folder)


def _merged_capture(folder: Path) -> o.Measured:
    from hybrid.cli.capture import print_views
    from hybrid.preparation.capture_parts import merge_capture

    frames = merge_capture(folder)
    print_views(frames)
    return {
        "scene": frames.scene_name,
        "views": len(frames.training),
        "held_out": len(frames.held_out),
        "integrator": frames.integrator,
    }


def _merged_preparation(folder: Path) -> o.Measured:
    from hybrid.cli.capture import print_views
    from hybrid.preparation.capture_parts import merge_preparation
    from hybrid.preparation.forest_errors import held_out_quality

    frames, forest = merge_preparation(folder, progress_bar)
    print_views(frames)
    rows = held_out_quality(frames, forest)
    quality = {name: rows[-1][name] for name in ("psnr", "ssim") if name in rows[-1]}
    held_out = f", held-out views {quality['psnr']:.2f} dB" if quality else ""
    print(f"{len(forest.finest):,} Gaussians in {folder / 'forest.safetensors'}{held_out}")
    return {
        "scene": frames.scene_name,
        "views": len(frames.training),
        "gaussians": len(forest.finest),
        "splat": quality,
        "forest": str(folder / "forest.safetensors"),
    }


def _merged_sweep(folder: Path) -> o.Measured:
    from hybrid.cli.sweep import print_sweep
    from hybrid.evaluation.sweep_run import merged_sweep

    content = merged_sweep(folder)
    print_sweep(content, content.get("fovea", ""))
    return content


def _merged_evaluation(folder: Path) -> o.Measured:
    from hybrid.cli.evaluate import print_evaluation
    from hybrid.evaluation.evaluation import merged_evaluation
    from hybrid.evaluation.evaluation_page import write_evaluation

    content = merged_evaluation(folder)
    write_evaluation(folder, content)
    print_evaluation(folder, content)
    return content


# How parts are joined, by the kind that they were begun with.
_MERGES: dict[str, Callable[[Path], o.Measured]] = {
    "capture": _merged_capture,
    "prepare": _merged_preparation,
    "sweep": _merged_sweep,
    "evaluate": _merged_evaluation,
}


def on_ray(address: str, part: str | None, folder: Path | None, is_timed: bool = False) -> o.Measured:
    """Does all parts of this command, as it was given, as tasks of Ray, and merges them.

    A part whose worker dies is begun again, and resumes from what is in the folder.

    Args:
        address: of the cluster; "local" starts Ray here.
        part: "all/N".
        folder: that all parts share; workers see it under the same absolute name.
        is_timed: whether parts measure times, so that each has a machine to itself.

    Raises:
        UserError: Ray is missing or does not answer, a part is refused or its workers die again and again,
            or `merge` raises it.
    """
    parts = _all_parts(part)
    ray = _started(address)
    errors = ray.exceptions
    lost = (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError)
    try:
        # The machines take turns, and no two parts share a process.
        options = {"max_retries": _RETRIES, "max_calls": 1, "scheduling_strategy": "SPREAD"}
        work = ray.remote(**options, **_claim(ray.nodes(), is_timed))(run_part)
        tasks = {
            work.options(name=f"hybrid {one}").remote(arguments_of(one, sys.argv[1:]), os.getcwd()): one
            for one in parts
        }
        with progress_bar("parts") as bar:
            bar(0, len(tasks))
            waiting = list(tasks)
            while waiting:
                (done, *_), waiting = ray.wait(waiting)
                try:
                    refused = ray.get(done)
                except lost as error:
                    raise UserError(f"--ray {address}: {tasks[done]}: {one_line(error)}") from error
                if refused:
                    raise UserError(f"{tasks[done]}: {refused}")
                bar(len(tasks) - len(waiting), len(tasks))
    finally:
        ray.shutdown()
    return merge(folder or Path())


def _claim(nodes: list[dict[str, Any]], is_timed: bool) -> dict[str, float]:
    """What a part claims of a machine of a cluster: a card, else, if it measures times, all cores."""
    has = [node["Resources"] for node in nodes if node["Alive"]]
    if any("GPU" in one for one in has):
        return {"num_gpus": 1}
    return {"num_cpus": min(one["CPU"] for one in has if "CPU" in one) if is_timed else 1}


def _all_parts(text: str | None) -> list[Part]:
    """The parts of "all/N"."""
    from hybrid.base.parts import Part, part_named

    if text is None or not text.startswith("all/"):
        raise UserError("--ray: requires --part all/N, the number of parts")
    with o.option_names("part"):
        count = part_named(f"1/{text.removeprefix('all/')}").count
    return [Part(number, count) for number in range(1, count + 1)]


def _started(address: str) -> ModuleType:
    """Ray, connected to a cluster."""
    try:
        import ray
    except ImportError as error:
        raise UserError("--ray requires Ray: pip install 'foveated-hybrid-renderer[ray]'") from error
    try:
        # Paths and caches are those of this process.
        kept = {name: os.environ[name] for name in ("HYBRID_HOME",) if name in os.environ}
        ray.init(address, log_to_driver=False, logging_level="ERROR", runtime_env={"env_vars": kept})
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UserError(f"--ray {address}: no cluster answers ({one_line(error)})") from error
    return ray


def arguments_of(part: Part, given: Sequence[str]) -> list[str]:
    """The arguments of a command for one of its parts, from those for all of them."""
    command, *rest = given
    kept = [
        word
        for before, word in zip([command, *rest], rest, strict=False)
        if before not in _NOT_OF_PARTS and word.split("=")[0] not in _NOT_OF_PARTS
    ]
    return [command, "--part", f"{part.number}/{part.count}", *kept]


def run_part(arguments: list[str], folder: str) -> str | None:
    """Runs a command in a folder, in this process, a worker; returns why it is refused, else None."""
    os.chdir(folder)
    # Ray bounds the threads of libraries that are imported from now on, by a guess.
    os.environ.pop("OMP_NUM_THREADS", None)
    from hybrid.cli.main import app

    try:
        with messages_as_lines():
            app(arguments, standalone_mode=False)
    except UserError as error:
        return str(error)
    return None
