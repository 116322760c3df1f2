"""`hybrid study`: designs a study with observers, runs it, and analyses what they answered."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError
from compose.eye.gaze import load_gaze_trace, require_within_frame
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import FrameSettings

if TYPE_CHECKING:
    from compose.eye.gaze import GazeTrace
    from hybrid.study.clips import Conditions, Presentation, Preset
    from hybrid.study.design import Clip

study_app = typer.Typer(
    no_args_is_help=True, help="Study frames with observers: design, run and analyse (BT.500, 2AFC)."
)
_Study = Annotated[Path, typer.Argument(metavar="STUDY", help="Folder of the study.")]
_KINDS = "still", "trace", "walk", "play"


@study_app.command()
@o.with_json
def design(
    folder: _Study,
    scenes: Annotated[
        list[str], typer.Argument(metavar="SCENE...", help="Bundled scenes or Mitsuba XML files.")
    ],
    preset: Annotated[
        str,
        typer.Option(
            help="fpc: five views against the reference, three times each (DSIS of BT.500); fov-gs: four "
            "conditions graded after a benchmark; pairs: two-alternative forced choice."
        ),
    ] = "fpc",
    conditions: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="JSON file of conditions by name: a method (reference, hybrid or full) and settings of "
            "frames, such as fov_a. Default: those of the preset.",
        ),
    ] = None,
    forest: Annotated[
        list[Path] | None,
        o.inputs("--forest", metavar="FOREST", help="Forest of each scene, in their order. Default: newest."),
    ] = None,
    stimulus: Annotated[
        str,
        typer.Option(
            help="still; trace: the cross follows --gaze-trace; walk: between views; play: a moving scene."
        ),
    ] = "still",
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Duration of a stimulus. Default: the preset's.", min=0.1, max=600, callback=o.finite
        ),
    ] = None,
    fps: Annotated[int, typer.Option(help="Frames per second of videos.", min=1, max=240)] = 30,
    views: Annotated[
        int | None, typer.Option(help="Unseen views of each scene. Default: the preset's.", min=1, max=100)
    ] = None,
    repeats: Annotated[
        int | None, typer.Option(help="Votes on each comparison. Default: the preset's.", min=1, max=100)
    ] = None,
    observers: Annotated[
        int | None,
        typer.Option(
            help="Planned observers. Default: as --effect needs, else the preset's.", min=1, max=9999
        ),
    ] = None,
    effect: Annotated[
        float | None,
        typer.Option(
            help="Difference to be found: Cohen's d_z of mean votes, or JOD for pairs.",
            min=0.01,
            callback=o.finite,
        ),
    ] = None,
    power: Annotated[float, typer.Option(help="Probability to find it.", min=0.05, max=0.999)] = 0.8,
    attention: Annotated[
        int, typer.Option(help="Trials with a known answer, which check attention.", min=0, max=100)
    ] = 2,
    gaze_input: Annotated[
        str,
        typer.Option(
            help="none; mouse or stream (an eye tracker's, by Lab Streaming Layer): trials in which the "
            "observer looked away from the cross are repeated."
        ),
    ] = "none",
    consent: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Text to agree to. Default: a short one.")
    ] = None,
    instructions: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Text of the instructions. Default: the method's.")
    ] = None,
    ask: Annotated[
        list[str] | None,
        typer.Option(
            metavar="QUESTION", help="Ask observers, such as 'Age'. May be repeated. Default: nothing."
        ),
    ] = None,
    size: o.FixedSize = (1920, 1080),
    gaze: o.Gaze = None,
    gaze_trace: Annotated[
        Path | None, o.viewer(metavar="FILE", help="CSV file with a recorded gaze, for --stimulus trace.")
    ] = None,
    reference_spp: o.ReferenceSpp = 256,
    display: o.DisplayName = "desktop",
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Render the stimuli of a study, and write its design; resumes if interrupted."""
    from hybrid.study.clips import PRESETS, Presentation, load_conditions

    _one_of("--preset", preset, PRESETS)
    _one_of("--stimulus", stimulus, _KINDS)
    _one_of("--gaze-input", gaze_input, ("none", "mouse", "stream"))
    chosen = PRESETS[preset]
    if forest and len(forest) != len(scenes):
        raise UserError(f"--forest: {len(forest)} for {len(scenes)} scenes; must be one for each, or none")
    o.require_size(size)
    frame = FrameSettings(gaze=gaze or FrameSettings().gaze, display=display)
    require_within_frame(frame.gaze.x, frame.gaze.y)
    shown = Presentation(
        stimulus,
        seconds or chosen.timing.stimulus,
        fps,
        size,
        frame,
        _trace(gaze_trace, stimulus, frame, size),
        views or chosen.views,
        reference_spp,
        seed,
    )
    wanted = chosen.conditions if conditions is None else load_conditions(conditions)
    texts: dict[str, Any] = {"consent": _text(consent), "instructions": _text(instructions)}
    trials = (repeats or chosen.repeats) * shown.views * len(scenes)
    planned = observers or _observers(chosen, effect, power, trials)
    o.check_writable(folder / "study.json")
    o.select(backend)
    with o.option_names("stimulus"):
        clips = _rendered(folder, scenes, forest, wanted, shown)
    from dataclasses import replace

    from hybrid.study.design import Design, compared

    made = Design(
        folder.resolve().name,
        chosen.method,
        replace(chosen.timing, stimulus=shown.seconds),
        tuple(clip for each in clips.values() for clip in each),
        **compared(chosen.method, clips, attention),
        repeats=repeats or chosen.repeats,
        observers=planned,
        size=size,
        pixels_per_degree=frame.display.pixels_per_degree,
        gaze=gaze_input,
        fields=tuple({"name": f"q{n}", "label": one, "type": "text"} for n, one in enumerate(ask or (), 1)),
        seed=seed,
        **{name: text for name, text in texts.items() if text},
    )
    made.save(folder)
    length, minutes = len(made.order(0)), made.minutes(0)
    print(f"{folder}: {planned} observers, {length} trials each, about {minutes:.0f} minutes")
    return {"observers": planned, "trials": length, "minutes": minutes}


def _one_of(option: str, given: str, known: Iterable[str]) -> None:
    if given not in known:
        raise UserError(f"{option} {given}: must be {', '.join(known)}")


def _text(file: Path | None) -> str:
    from compose.base.errors import reading

    if file is None:
        return ""
    with reading(file):
        return file.read_text(encoding="utf-8-sig").strip()


def _trace(file: Path | None, stimulus: str, frame: FrameSettings, size: tuple[int, int]) -> GazeTrace | None:
    if (file is None) == (stimulus == "trace"):
        raise UserError("--gaze-trace: must be given with --stimulus trace, and only then")
    return None if file is None else load_gaze_trace(file).on(frame.display, *size)


def _observers(preset: Preset, effect: float | None, power: float, trials: int) -> int:
    """As many observers as a difference needs, with so many trials of a pair each; else the preset's."""
    from hybrid.study.comparisons import observers_for_difference, observers_for_preference
    from hybrid.study.design import StudyMethod
    from hybrid.study.scaling import preference

    if effect is None:
        return preset.observers
    if preset.method is StudyMethod.PAIRS:
        return observers_for_preference(preference(effect), trials, power=power)
    return observers_for_difference(effect, power=power)


def _rendered(
    folder: Path,
    scenes: list[str],
    forests: list[Path] | None,
    conditions: Conditions,
    shown: Presentation,
) -> dict[str, list[Clip]]:
    from hybrid.preparation.preparation import with_forest
    from hybrid.render.frame_renderer import Renderer
    from hybrid.render.irradiance import cache_for
    from hybrid.study.clips import Stimuli

    clips: dict[str, list[Clip]] = {}
    for number, name in enumerate(scenes):
        scene, forest = with_forest(o.loaded_scene(name), forests[number] if forests else None, progress_bar)
        stimuli = Stimuli(folder, Renderer(scene, forest), conditions, shown)
        if stimuli.needs_irradiance():
            cache_for(scene, progress_bar)
        with progress_bar(f"clips of {scene.name}") as bar:
            clips |= stimuli.render(bar)
    return clips


@study_app.command()
@o.with_json
def run(
    folder: _Study,
    observer: Annotated[
        int | None,
        typer.Option(help="Number of the observer, to resume. Default: the next.", min=1, max=9999),
    ] = None,
    browser: Annotated[bool, typer.Option("--browser", help="In a browser on this machine.")] = False,
    simulate: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Instead, let N simulated observers answer, who see what FovVideoVDP sees.",
            min=1,
            max=9999,
        ),
    ] = None,
    display: o.DisplayName = "desktop",
    seed: o.Seed = 0,
) -> o.Measured:
    """Run a study with one observer, full screen; closed or killed, it resumes with --observer N."""
    from hybrid.study.design import load_design
    from hybrid.study.session import StudySession, next_observer

    loaded = load_design(folder)
    number = observer or next_observer(folder)
    if simulate is not None:
        from compose.eye.display import display_named
        from hybrid.study.simulated_observers import SimulatedObserver, clip_qualities

        with progress_bar("qualities of clips") as bar:
            jods = clip_qualities(folder, loaded, display_named(display), bar)
        for one in range(number, number + simulate):
            session = StudySession(folder, loaded, one)
            SimulatedObserver(loaded, jods, one, seed).run(session)
            session.close()
        print(f"{folder}: observers {number} to {number + simulate - 1} were simulated")
        return {"observers": [*range(number, number + simulate)], "complete": True}
    if not browser:
        from hybrid.window.qt_check import require_window

        require_window()
    stream = None
    if loaded.gaze == "stream":
        from hybrid.study.session import LabStream

        stream = LabStream()
    session = StudySession(folder, loaded, number, stream)
    print(f"observer {number}; to resume: hybrid study run {folder} --observer {number}", flush=True)
    try:
        if browser:
            from hybrid.study.browser import serve_study

            serve_study(session, lambda address: print(f"open {address}", flush=True))
        else:
            from hybrid.study.study_window import run_study_window

            run_study_window(session)
    finally:
        session.close()
        if stream is not None:
            stream.close()
    print(f"{session.file}: " + ("complete" if session.done else "not complete yet"))
    return {"observers": [number], "complete": session.done}


@study_app.command()
@o.with_json
def analyse(
    source: Annotated[
        Path,
        typer.Argument(metavar="STUDY|CSV", help="Folder of a study, or a CSV file of one run elsewhere."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the page, its tables and the answers.")
    ],
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=COLUMNS",
            help="Columns of a CSV file that are meant by observer, scene, condition, vote, first, second or "
            "chosen, such as first=texture_1+rate_1. May be repeated.",
        ),
    ] = None,
    scale: Annotated[
        tuple[float, float], typer.Option(metavar="LOW HIGH", help="Ends of the scale of votes.")
    ] = (1.0, 5.0),
    reference: Annotated[
        str | None,
        typer.Option(help="Condition at 10 JOD. Default: 'reference' if there is one, else their mean is 0."),
    ] = None,
    margin: Annotated[
        float,
        typer.Option(
            help="Largest difference, in steps or JOD, that is equivalence.", min=0.001, callback=o.finite
        ),
    ] = 0.25,
    level: Annotated[float, typer.Option(help="Level of intervals.", min=0.5, max=0.999)] = 0.95,
    keep_all: Annotated[
        bool,
        typer.Option(
            "--keep-all",
            help="Leave no observer out, neither by BT.500's screening of votes nor for attention.",
        ),
    ] = False,
) -> o.Measured:
    """Analyse what observers answered: opinion scores or JOD with intervals, tests, equivalence; one page."""
    from hybrid.study.analysis import AnalysisSettings
    from hybrid.study.analysis import analyse as analysed
    from hybrid.study.analysis_page import write_page
    from hybrid.study.design import REFERENCE
    from hybrid.study.observations import Ratings, answers, conditions_of, save

    found, dropped = answers(source, _columns(column), scale, keep_all)
    anchor = reference or (REFERENCE if REFERENCE in conditions_of(found) else None)
    # Of choices, those whom others contradict are named and kept: leaving them out has no standard.
    screens = isinstance(found, Ratings) and not keep_all
    settings = AnalysisSettings(level, margin, anchor, 0.0 if anchor is None else 10.0, screen=screens)
    result = analysed(found, settings)
    if dropped:
        result["sentences"].insert(1, f"Left out, as they failed to attend: observers {', '.join(dropped)}.")
    write_page(out, result)
    save(out / "answers.csv", found)
    for line in (*result["sentences"], out / "index.html"):
        print(line)
    return result


def _columns(given: list[str] | None) -> dict[str, str]:
    pairs = [one.partition("=") for one in given or ()]
    if wrong := [name for name, equals, value in pairs if not (equals and value)]:
        raise UserError(f"--column {wrong[0]}: must be NAME=COLUMNS")
    return {name.strip(): value for name, _, value in pairs}
