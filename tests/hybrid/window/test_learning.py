"""What is learnt beside the window, what of it is shown, and the watch of a scene's files."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import asdict, replace
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
import torch

from compose.camera.camera import Camera, turned
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import newest_forest, store_forest
from hybrid.preparation.earlier_jobs import newest_job
from hybrid.preparation.scene_plan import as_planned, as_stored, with_plan_of
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.window import learning
from hybrid.window.frame_source import SceneSource, prepared
from hybrid.window.learning import Learner, SceneWatch, ShownScene, Task, Watched, forest_to_show
from hybrid.window.messages import Request
from pathtrace.dataset import changed_frames
from pathtrace.scene.scene import bundled_scenes, load_scene
from pathtrace.trace import Integrator
from splat.io.forest_file import load_forest, save_forest
from splat.model.forest import Forest
from splat.model.gaussians import SH_DC
from tests.extremes import extreme
from tests.hybrid.preparation.tiny import make_tiny, tiny_home
from tests.moving import moving_corner

pytestmark = pytest.mark.usefixtures("backend", "own_home")
CORNELL = ShownScene("cornell")
# Seconds within which a process has begun and ended, on any machine.
PATIENCE = 120


class Said:
    """Lines that were said; `heard` is set with the first one."""

    def __init__(self):
        self.lines: list[str] = []
        self.heard = threading.Event()

    def __call__(self, line: str) -> None:
        self.lines.append(line)
        self.heard.set()


def quiet(done: int, total: int, label: str) -> None:
    """Ignores progress."""


def learn(task: Task, shown: ShownScene = CORNELL) -> list[tuple[str, Path | None, bool]]:
    """What the process tells that learns a scene, without those about its progress."""
    told: list[tuple[str, Path | None, bool]] = []
    learning._learn(shown, task, lambda line, forest=None, more=False: told.append((line, forest, more)))
    return [one for one in told if not one[0].startswith("learning: ")]


@pytest.fixture
def tiny(monkeypatch):
    make_tiny(monkeypatch.setattr)


@pytest.fixture(scope="module")
def first_home(tmp_path_factory, backend) -> tuple[Path, list[tuple[str, Path | None, bool]]]:
    """A cache folder in which the Cornell box is learnt, and what was told."""
    home = tmp_path_factory.mktemp("first")
    with tiny_home(home):
        return home, learn(Task())


@pytest.fixture
def learnt(first_home, tiny):
    """The Cornell box is learnt in the cache folder."""
    shutil.copytree(first_home[0], os.environ["HYBRID_HOME"], dirs_exist_ok=True)


def test_each_stage_is_told_with_its_forest_and_the_last_one_again(first_home, tiny, monkeypatch):
    home, told = first_home
    monkeypatch.setenv("HYBRID_HOME", str(home))
    assert [line.split(", ")[0].split("frames ")[-1] for line, _, _ in told] == [
        "after stage 1 of 3",
        "after stage 2 of 3",
        "after stage 3 of 3",
        "all stages are learnt",
    ]
    forests = [load_forest(path) for _, path, _ in told]
    # What follows the last stage changes no Gaussian.
    assert len({forest.digest() for forest in forests}) == 3
    newest = newest_forest(as_planned(load_scene("cornell")))
    assert newest.name.startswith("live-")
    assert forest_to_show(as_planned(load_scene("cornell"))) == (newest, True)
    assert learn(Task()) == [told[-1]]


def test_a_forest_that_was_prepared_is_told_instead_of_another(made):
    scene = as_planned(load_scene("cornell"))
    store_forest(load_forest(made / "box.forest"), "mine")
    assert learn(Task()) == [("prepared earlier", newest_forest(scene), False)]
    assert forest_to_show(scene) == (newest_forest(scene), False)


def test_a_process_says_why_it_has_ended():
    said = Said()
    learner = Learner(ShownScene("no-such-scene"), Task(), said)
    assert said.heard.wait(PATIENCE)
    learner.stop()
    assert said.lines[0].startswith("learning has ended: no-such-scene: no such scene")
    assert learner.forests.take() is None


def test_a_forest_is_awaited_until_none_follows_soon(made, monkeypatch):
    begun, awaited = threading.Event(), []

    class Process:
        stdin = stdout = None

        def __init__(self, *given, **named):
            self.stdout = self.lines()

        def lines(self):
            assert begun.wait(PATIENCE)
            yield json.dumps({"line": "begins"})
            for more in (True, False):
                yield json.dumps({"line": "", "forest": str(made / "box.forest"), "more": more})

        def wait(self):
            return 0

    monkeypatch.setattr(subprocess, "Popen", Process)
    done = threading.Event()

    def say(line: str) -> None:
        awaited.append(learner.is_awaited)
        if len(awaited) == 3:
            done.set()

    learner = Learner(CORNELL, Task(urgent=True), say)
    begun.set()
    assert done.wait(PATIENCE)
    assert awaited == [True, True, False]


@pytest.mark.parametrize(("count", "left"), [(2, 1), (3, 2), (8, 4)])
def test_learning_has_half_of_the_threads_while_a_forest_is_awaited_or_a_view_rests(
    monkeypatch, threads, count, left
):
    """Until it is there, or learning ends."""
    threads(count)
    watched = Watched(CORNELL, True, lambda line: None)
    watched.share_threads(rests=True)
    assert dr.thread_count() == count

    class Learning:
        is_running = True

        def __init__(self, scene, task, say):
            self.is_awaited = task.urgent

        def stop(self):
            pass

    monkeypatch.setattr(learning, "Learner", Learning)
    for is_over in (lambda: setattr(watched._learner, "is_awaited", False), watched.stop):
        watched.learn(Task(urgent=True))
        assert dr.thread_count() == left
        is_over()
        watched.share_threads()
        assert dr.thread_count() == count
    watched.learn(Task())
    assert dr.thread_count() == count
    watched.share_threads(rests=True)
    assert dr.thread_count() == left
    watched._learner.is_running = False
    watched.share_threads(rests=True)
    assert dr.thread_count() == count


@pytest.mark.parametrize("ctrl_c", [signal.default_int_handler, signal.SIG_IGN])
def test_a_process_ends_with_the_window(ctrl_c):
    """Shells have what they start in the background ignore Ctrl-C."""
    said, before = Said(), signal.signal(signal.SIGINT, ctrl_c)
    try:
        learner = Learner(CORNELL, Task(), said)
    finally:
        signal.signal(signal.SIGINT, before)
    assert said.heard.wait(PATIENCE)
    learner.stop()
    assert learner._process.wait(PATIENCE) == 0
    assert not any("unexpectedly" in line for line in said.lines)


@extreme(
    "a window that is gone before what learns beside it has begun",
    given="both pipes closed at once, of a scene and of one that is missing",
    expected="an end without an error",
)
@pytest.mark.parametrize("shown", [CORNELL, ShownScene("no-such-scene")], ids=["a scene", "none"])
def test_a_process_whose_window_is_gone_ends_quietly(shown, got):
    given = json.dumps({"scene": asdict(shown), "task": asdict(Task())})
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen([sys.executable, "-m", learning.__name__, given], text=True, **pipes) as process:
        process.stdout.close()
        process.stdin.close()
        assert "Traceback" not in process.stderr.read()
        assert got(process.wait(PATIENCE)) == 0


@pytest.mark.parametrize(("is_apart", "more"), [(True, learning._NICE), (False, 0)])
def test_a_group_of_processes_gives_way_unless_the_window_is_in_it(is_apart, more):
    """To one that has less than usual itself."""
    if not os.path.exists("/proc/self/autogroup"):
        pytest.skip("Linux without groups by session")
    say = "from pathlib import Path; print(Path('/proc/self/autogroup').read_text().split()[-1])"
    child = f"from hybrid.window.learning import _give_way as give; give(); {say}"
    window = f"""
import os, subprocess, sys
from pathlib import Path
Path("/proc/self/autogroup").write_text("3")
subprocess.run([sys.executable, "-c", {child!r}], start_new_session={is_apart}, check=True)
{say}"""
    words = [sys.executable, "-c", window]
    found = subprocess.run(words, start_new_session=True, check=True, capture_output=True, text=True).stdout
    assert found.split() == [str(3 + more), "3"]


@pytest.mark.parametrize(
    ("own", "above", "nice"),
    [
        ("/autogroup-7 nice 0\n", "/autogroup-5 nice 3\n", 3 + learning._NICE),
        ("/autogroup-7 nice 0\n", "/autogroup-5 nice 19\n", 19),
        ("/autogroup-7 nice 0\n", "", learning._NICE),
        ("/autogroup-7 nice 0\n", "/autogroup-7 nice 0\n", None),
        ("", "/autogroup-5 nice 3\n", None),
        ("", "", None),
    ],
)
def test_processes_in_no_group_give_way_too(own, above, nice):
    """As those which the first process of a container starts."""
    assert learning._nice_of_group(own, above) == nice


class FakeWatched(Watched):
    """Something that changes and learns when it is told to."""

    def __init__(self):
        self.forests, self.scenes, self.tasks = [], [], []

    @property
    def learns(self):
        return True

    def learnt(self):
        return self.forests.pop() if self.forests else None

    def changed(self):
        return self.scenes.pop() if self.scenes else None

    def learn(self, task):
        self.tasks.append(task)

    def share_threads(self, rests=False):
        self.rests = rests


@pytest.fixture
def own_source(made):
    forest = load_forest(made / "box.forest")
    watched = FakeWatched()
    return SceneSource(
        LiveRenderer(as_planned(load_scene("cornell")), forest), watched, made / "box.forest"
    ), watched


def darkened(forest: Forest) -> Forest:
    """A forest without light: perceptual radiance is stored minus 0.5."""
    sh = torch.zeros_like(forest.nodes.gaussians.sh)
    sh[0] = -0.5 / SH_DC
    dark = replace(forest.nodes.gaussians, sh=sh, directional=None)
    return replace(forest, nodes=replace(forest.nodes, gaussians=dark))


def asked(source: SceneSource, integrator: Integrator = Integrator.PATH) -> Request:
    settings = FrameSettings(Gaze(0.4, 0.5), 20.0, 15.0, 1, camera=source.camera.resized(96, 64))
    return Request(replace(settings, fovea="raw", integrator=integrator))


def test_a_better_forest_is_shown_from_the_next_frame_on(own_source):
    source, watched = own_source
    assert not source.renew(quiet)
    source.show(asked(source), quick=False)
    assert watched.rests
    source.show(asked(source), quick=True)
    assert not watched.rests
    forest, splats = source.renderer.periphery.forest, source.renderer.splats(asked(source).settings)
    watched.forests.append((Path("next.safetensors"), darkened(forest)))
    assert source.renew(quiet)
    after = source.show(asked(source), quick=True)
    assert source.renderer.splats(asked(source).settings).mean() < 0.5 * splats.mean()
    # The disc begins anew.
    assert after.spp == 1


@pytest.mark.parametrize(("integrator", "light"), [(Integrator.PATH, 1.0), (Integrator.CACHED, 0.1)])
def test_a_changed_scene_is_shown_with_the_splats_of_before(own_source, tmp_path, integrator, light):
    """In the light of now, if that is known; and with its disc. They are learnt further, then shown."""
    source, watched = own_source
    before = source.show(asked(source, integrator), quick=True)
    splats = source.renderer.splats(asked(source).settings)
    file = tmp_path / "cornell" / "scene.xml"
    file.parent.mkdir()
    file.write_text(bundled_scenes()["cornell"].read_text().replace('"30, 26, 18"', '"3, 2.6, 1.8"'))
    changed = load_scene(file)
    watched.scenes.append(changed)
    assert source.renew(quiet)
    after = source.show(asked(source, integrator), quick=True)
    assert source.renderer.scene.own_hash == changed.own_hash
    # As the scene before was planned; its plan is now that of this one.
    assert source.renderer.scene.plan == as_stored(load_scene(file)).plan != {}
    shown = source.renderer.splats(asked(source).settings)
    if light == 1:
        np.testing.assert_allclose(shown, splats, atol=1e-6)
    assert shown.mean() == pytest.approx(light * splats.mean(), rel=0.05)
    disc = [np.mean(shown.frame.fovea.radiance) for shown in (before, after)]
    assert 0.05 < disc[1] / disc[0] < 0.2
    task = watched.tasks.pop()
    assert task.urgent
    assert load_forest(task.start).digest() == source.renderer.periphery.forest.digest()
    learnt = replace(darkened(source.renderer.periphery.forest), scene_hash=source.renderer.scene.hash)
    watched.forests.append((Path("next.safetensors"), learnt))
    assert source.renew(quiet)
    assert source.renderer.splats(asked(source).settings).mean() < 0.5 * splats.mean()


def walked(source: SceneSource, steps: float) -> Request:
    """A request from further to the right, in units of what the camera sees, turned a little."""
    scene = source.renderer.scene
    request, distance = asked(source), scene.surfaces().median_distance(scene.camera)
    camera = request.settings.camera.moved_right(steps * distance)
    return replace(request, settings=replace(request.settings, camera=camera))


def test_where_a_viewer_stays_is_learnt(own_source, monkeypatch, made):
    """Once, from the frames of before, and only beyond what training views show."""
    source, watched = own_source
    clock = [0.0]
    monkeypatch.setattr(learning.time, "monotonic", lambda: clock[0])

    def shown(request: Request, seconds: float) -> None:
        source.show(request, quick=True)
        for _ in range(2):
            source.renew(quiet)
            clock[0] += seconds

    shown(walked(source, 0.0), 3.0)
    shown(walked(source, 0.05), 3.0)
    # Passing by.
    shown(walked(source, 0.25), 1.0)
    assert not watched.tasks
    for _ in range(2):
        shown(walked(source, 0.2), 3.0)
    (task,) = watched.tasks
    assert (task.start, task.urgent) == (str(made / "box.forest"), True)
    assert Camera.of_key(bytes.fromhex(task.place)) == walked(source, 0.2).settings.camera
    # It is being learnt already.
    shown(walked(source, 0.22), 3.0)
    assert len(watched.tasks) == 1
    # A change of the scene is learnt there.
    watched.scenes.append(load_scene("cornell"))
    source.renew(quiet)
    assert watched.tasks[1].place == task.place
    assert watched.tasks[1].urgent


def test_a_viewer_who_looks_at_nothing_is_not_followed(own_source, monkeypatch):
    source, watched = own_source
    monkeypatch.setattr(learning, "_STAYS", 0.0)
    request = asked(source)
    pose = request.settings.camera.camera_to_world.copy()
    pose[:3, :3] = turned(pose[:3, :3], 180.0, 0.0)
    camera = request.settings.camera.at(pose)
    source.show(replace(request, settings=replace(request.settings, camera=camera)), quick=True)
    source.renew(quiet)
    assert not watched.tasks


def test_learning_goes_on_where_it_was(learnt):
    """In another window, which is not told of the place."""
    scene = as_planned(load_scene("cornell"))
    pose = scene.camera.camera_to_world.copy()
    pose[:3, 3] -= 0.2 * scene.surfaces().median_distance(scene.camera) * pose[:3, 2]
    place, before = scene.camera.at(pose).key.hex(), newest_job(scene)
    assert before is not None
    there = learn(Task(str(newest_forest(scene)), job=str(before.folder), place=place))
    assert "after stage 4 of 5" in there[0][0]
    found = newest_job(scene)
    assert found is not None
    assert found.folder.parent == before.folder.parent
    assert found.place.key.hex() == place
    assert learn(Task()) == [there[-1]]


def test_of_a_change_a_little_is_learnt_soon_and_then_all(learnt, tmp_path, monkeypatch):
    """The first forest comes from new frames alone, the next ones from those of before."""
    # So few samples differ from others in every tile.
    monkeypatch.setattr(changed_frames, "_LIGHT", 0.15)
    scene = as_planned(load_scene("cornell"))
    file = tmp_path / "cornell" / "scene.xml"
    file.parent.mkdir()
    text = bundled_scenes()["cornell"].read_text()
    file.write_text(text.replace("0.35, -0.7, 0.36", "0.25, -0.7, 0.3"))
    changed = with_plan_of(load_scene(file), scene)
    forest = replace(load_forest(newest_forest(scene)), scene_name=changed.name, scene_hash=changed.hash)
    save_forest(tmp_path / "changed.safetensors", forest)
    task = Task.after(scene, tmp_path / "changed.safetensors", None)
    told = [(line, more) for line, _, more in learn(task, ShownScene(str(file)))]
    assert [(line.split("after ")[-1].split(",")[0], more) for line, more in told] == [
        ("stage 1 of 1", True),
        ("stage 4 of 5", False),
        ("stage 5 of 5", False),
        ("all stages are learnt", False),
    ]
    assert len(newest_job(changed).stages) == 5


def test_a_scene_that_moves_is_not_planned_as_one_that_stands_still(tmp_path):
    still, moving = as_planned(load_scene("cornell")), moving_corner(tmp_path)
    assert with_plan_of(moving, still) is moving


@extreme(
    "a scene's file broken while it is watched",
    given="an element that is none, then the file as it was",
    expected="one line, the scene as it was; then shown anew",
)
def test_a_scene_that_cannot_be_read_stays_as_it_was(tmp_path, monkeypatch, got):
    file = tmp_path / "scene.xml"
    file.write_text(bundled_scenes()["cornell"].read_text())
    monkeypatch.setattr(learning, "_LOOK_EVERY", 0.0)
    said = Said()
    watched = Watched(ShownScene(str(file)), False, said)
    assert watched.changed() is None
    file.write_text(bundled_scenes()["cornell"].read_text().replace("emitter", "light"))
    assert [watched.changed() for _ in range(2)] == [None, None]
    assert said.lines
    assert said.lines[0].endswith("; shown as it was")
    file.write_text(bundled_scenes()["cornell"].read_text() + "\n")
    assert [watched.changed() is not None for _ in range(2)] == [False, True]
    got(said.lines[0].replace(str(tmp_path), ""))


def test_a_glimpse_is_shown_where_there_is_no_forest(tiny):
    """It is that of the scene without a plan, for which there is no time."""
    assert forest_to_show(load_scene("cornell")) == (None, True)
    source = prepared(CORNELL, None, False, FrameSettings(fovea="raw"), quiet, Said())
    assert source.layers == 1
    path, learns = forest_to_show(load_scene("cornell"))
    assert learns
    assert load_forest(path).digest() == source.renderer.periphery.forest.digest()
    source.close()


SCENE = '<scene version="3.0.0"><string name="filename" value="{}"/></scene>'


@pytest.fixture
def watched(tmp_path, monkeypatch):
    """A scene's file, and what looks at it each time it is asked."""
    monkeypatch.setattr(learning, "_LOOK_EVERY", 0.0)
    (tmp_path / "a.obj").write_text("a")
    (tmp_path / "b.obj").write_text("b")
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format("a.obj"))
    return file, SceneWatch(file)


def looks(watch: SceneWatch) -> list[bool]:
    return [watch.changed() for _ in range(3)]


def test_a_changed_file_is_noticed_once(watched):
    file, watch = watched
    assert not any(looks(watch))
    file.with_name("a.obj").write_text("changed")
    # At first, it may still be being written.
    assert looks(watch) == [False, True, False]


def test_a_file_of_the_same_size_is_noticed_by_its_time(watched):
    file, watch = watched
    os.utime(file, ns=(1, 1))
    assert looks(watch) == [False, True, False]


def test_files_that_the_scene_does_not_name_do_not_matter(watched):
    file, watch = watched
    file.with_name("b.obj").write_text("changed")
    assert not any(looks(watch))
    file.write_text(SCENE.format("b.obj"))
    assert looks(watch) == [False, True, False]
    file.with_name("b.obj").write_text("changed again")
    assert looks(watch) == [False, True, False]


@extreme(
    "a scene's file that is half written, then gone",
    given="a window that watches it",
    expected="nothing until it can be read again",
)
def test_a_file_that_cannot_be_read_is_waited_for(watched, got):
    file, watch = watched
    file.write_text("<scene")
    assert not any(looks(watch))
    file.unlink()
    assert not any(looks(watch))
    file.write_text(SCENE.format("a.obj") + " ")
    assert looks(watch) == [False, True, False]
    got("waited for")


def test_it_does_not_look_all_the_time(watched, monkeypatch):
    file, watch = watched
    monkeypatch.setattr(learning, "_LOOK_EVERY", 1000.0)
    file.with_name("a.obj").write_text("changed")
    assert not any(looks(watch))
