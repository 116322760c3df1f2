"""From a scene to a hybrid frame in Python.

    python examples/render_frame.py cornell work --quick

Captures training frames of a scene, trains a forest on them, and renders one frame with the gaze right of the
centre. Everything lies in one folder; an interrupted run resumes. Takes about seven minutes on two cores with
the default settings, and seconds with --quick, whose result is only a sketch.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import hybrid


def main() -> None:
    parser = argparse.ArgumentParser(description="Captures, trains, and renders one hybrid frame.")
    parser.add_argument("scene", help="name of a bundled scene, or a Mitsuba XML file")
    parser.add_argument("folder", type=Path, help="for everything that is written")
    parser.add_argument("--quick", action="store_true", help="small frames and few steps")
    arguments = parser.parse_args()
    folder: Path = arguments.folder
    capture, training = hybrid.CaptureSettings(), hybrid.TrainingSettings()
    if arguments.quick:
        capture = hybrid.CaptureSettings(views=6, held_out=0, width=64, height=64, spp=4)
        training = hybrid.TrainingSettings(iterations=60, gaussians=2_000, layers=2, degree=1)

    scene = hybrid.load_scene(arguments.scene)
    frames = hybrid.capture(scene, folder / "frames", capture)
    forest = hybrid.train(frames, folder / "scene.forest", training)

    renderer = hybrid.Renderer(scene, forest)
    settings = hybrid.FrameSettings(gaze=(0.6, 0.5), spp=4)
    frame = renderer.frame(settings)
    frame.save(folder / "frame.png")
    frame.save(folder / "frame.exr")
    traced = frame.region.count
    print(f"{folder / 'frame.png'}: {frame.milliseconds['total']:.0f} ms, {traced:,} pixels traced")


if __name__ == "__main__":
    main()
