"""Commands with --part and --ray, and `hybrid merge`."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import sys
import threading
import time
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from hybrid.base.cache_folder import has_receipt, home, newest_forest
from hybrid.base.identity import code
from hybrid.base.parts import Part
from hybrid.cli.many_machines import _claim, arguments_of
from hybrid.preparation import capture_parts
from hybrid.preparation.scene_plan import as_stored
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests.extremes import extreme
from tests.hybrid.command import run
from tests.hybrid.preparation.tiny import make_tiny

pytestmark = pytest.mark.usefixtures("backend", "own_home")
CAPTURE = ["capture", "cornell"]
OPTIONS = ["--views", 4, "--held-out", 2, "--size", 24, 16, "--spp", 2, "--held-out-spp", 4]


def contents(folder: Path) -> dict[str, str]:
    """Hash of each file in a folder by its name."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def renderings(folder: Path) -> list[set[str]]:
    """Names of the frames of each part."""
    return [{path.name for path in part.glob("frames/*")} for part in sorted(folder.glob("part-*"))]


def test_a_capture_in_parts_is_that_of_one_machine_to_the_bit(monkeypatch, tmp_path, capsys):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert run(monkeypatch, *CAPTURE, whole, *OPTIONS) == 0
    for number in (2, 1):
        assert run(monkeypatch, *CAPTURE, parts, *OPTIONS, "--part", f"{number}/2") == 0
    assert f"part 2 of 2 in {parts / 'part-2-of-2'}; when all are there: hybrid merge {parts}" in (
        capsys.readouterr().out
    )
    expected, shares = contents(whole), renderings(parts)
    # Each file once; the costly held-out views are not all of one part.
    assert sorted(f"frames/{name}" for share in shares for name in share) == sorted(
        expected.keys() - {"transforms.json"}
    )
    held_out = [entry.file.name for entry in read_frame_set(whole).held_out]
    assert sum(bool(share & {*held_out}) for share in shares) == 2
    assert run(monkeypatch, "merge", parts, "--json", tmp_path / "m.json") == 0
    assert contents(parts) == expected
    assert [path.name for path in sorted(parts.iterdir())] == ["frames", "transforms.json"]
    assert has_receipt(read_frame_set(parts))
    assert json.loads((tmp_path / "m.json").read_text())["views"] == 4
    # Again, as a job of a cluster may be.
    assert run(monkeypatch, "merge", parts) == 0
    assert contents(parts) == expected


@pytest.fixture(scope="module")
def two_parts(backend, tmp_path_factory) -> Path:
    """The folder of two finished parts of a capture."""
    folder = tmp_path_factory.mktemp("two") / "parts"
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("HYBRID_HOME", str(folder.parent / "home"))
        for number in (1, 2):
            options = [*OPTIONS, "--integrator", "path", "--part", f"{number}/2"]
            assert run(monkeypatch, *CAPTURE, folder, *options) == 0
    return folder


@pytest.fixture
def parts(two_parts, tmp_path) -> Path:
    return Path(shutil.copytree(two_parts, tmp_path / "parts"))


@extreme(
    "lost files of a part",
    given="a finished part of a capture, one of whose frames is gone",
    expected="refused by name before anything moves; the part alone is run again",
)
def test_a_part_that_lost_a_file_is_refused_and_run_again(parts, monkeypatch, capsys, got):
    gone = min((parts / "part-2-of-2" / "frames").iterdir())
    expected = hashlib.sha256(gone.read_bytes()).hexdigest()
    gone.unlink()
    before = contents(parts)
    assert run(monkeypatch, "merge", parts) == 2
    said = capsys.readouterr().err
    assert (
        f"1 of {len(list(parts.glob('*/frames/*'))) + 1} files are in no part (frames/{gone.name} first)"
        in said
    )
    assert contents(parts) == before
    options = [*OPTIONS, "--integrator", "path", "--part", "2/2"]
    assert run(monkeypatch, *CAPTURE, parts, *options) == 0
    assert run(monkeypatch, "merge", parts) == 0
    assert hashlib.sha256((parts / "frames" / gone.name).read_bytes()).hexdigest() == expected
    got(said.strip().replace(str(parts), ""))


def test_an_interrupted_part_is_unfinished_and_resumes(parts, monkeypatch, capsys):
    """The frames that are there stay."""
    description = parts / "part-1-of-2" / "part.json"
    description.write_text(description.read_text().replace('"complete": true', '"complete": false'))
    kept, gone = sorted((parts / "part-1-of-2" / "frames").iterdir())[:2]
    gone.unlink()
    stamp = kept.stat().st_mtime_ns
    assert run(monkeypatch, "merge", parts) == 2
    assert "part 1 of 2 is not finished" in capsys.readouterr().err
    assert not (parts / "transforms.json").exists()
    assert run(monkeypatch, *CAPTURE, parts, *OPTIONS, "--integrator", "path", "--part", "1/2") == 0
    assert kept.stat().st_mtime_ns == stamp
    assert gone.exists()
    assert run(monkeypatch, "merge", parts) == 0


def test_a_part_of_another_version_is_refused_by_name(parts, monkeypatch, capsys):
    monkeypatch.setattr(capture_parts, "code", lambda: {**code(), "source": "3c4d"})
    assert run(monkeypatch, *CAPTURE, parts, *OPTIONS, "--integrator", "path", "--part", "2/2") == 2
    said = f"part 1 of 2 was made by another version: source {code()['source']}, this one 3c4d"
    assert said in capsys.readouterr().err


def test_all_parts_have_the_plan_of_the_first(parts, monkeypatch):
    """Wherever their own cache folder lies: it has none here."""
    shutil.rmtree(parts / "part-2-of-2")
    monkeypatch.setattr(capture_parts, "as_planned", None)
    monkeypatch.setattr(capture_parts, "chosen_capture", None)
    assert run(monkeypatch, *CAPTURE, parts, *OPTIONS, "--integrator", "path", "--part", "2/2") == 0
    assert not list(home().glob("*/plan.json"))
    assert run(monkeypatch, "merge", parts) == 0


def test_a_whole_capture_takes_no_parts(parts, monkeypatch, capsys):
    assert run(monkeypatch, "merge", parts) == 0
    whole = contents(parts)
    assert run(monkeypatch, *CAPTURE, parts, *OPTIONS, "--part", "1/2") == 2
    assert f"{parts}: holds a whole capture already" in capsys.readouterr().err
    assert contents(parts) == whole


PREPARE = ["prepare", "cornell", "--quality", "draft", "--held-out", 2]


@pytest.fixture
def prepared_parts(monkeypatch, tmp_path) -> Path:
    """The folder of two finished parts of a preparation of 6 views of 32 x 32."""
    make_tiny(monkeypatch.setattr)
    for number in (2, 1):
        assert run(monkeypatch, *PREPARE, "--part", f"{number}/2", "--shared", tmp_path / "p") == 0
    return tmp_path / "p"


def test_a_preparation_in_parts_becomes_frames_and_the_newest_forest(prepared_parts, monkeypatch, capsys):
    out = prepared_parts.parent / "m.json"
    assert run(monkeypatch, "merge", prepared_parts, "--json", out) == 0
    found, frames = json.loads(out.read_text()), read_frame_set(prepared_parts)
    assert (found["views"], len(frames.training), len(frames.held_out)) == (6, 6, 2)
    assert {entry.camera.width for entry in frames.training} == {32}
    forest = load_forest(prepared_parts / "forest.safetensors")
    assert found["gaussians"] == len(forest.finest) > 50
    assert found["splat"]["psnr"] > 10
    newest = newest_forest(as_stored(load_scene("cornell")).planned(frames.plan))
    assert newest is not None
    assert len(load_forest(newest).finest) == len(forest.finest)
    assert not list(prepared_parts.glob("part-*"))
    assert (
        f"{len(forest.finest):,} Gaussians in {prepared_parts / 'forest.safetensors'}"
        in capsys.readouterr().out
    )


@extreme(
    "a training of merged parts that is interrupted",
    given="Ctrl-C while the forest is trained",
    expected="the frames are joined, the parts stay, and merging again trains",
)
def test_an_interrupted_merge_of_a_preparation_goes_on(prepared_parts, monkeypatch, got):
    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(capture_parts, "train", interrupted)
        assert got(run(monkeypatch, "merge", prepared_parts)) != 0
    assert len(list(prepared_parts.glob("frames/*"))) == 8
    assert len(list(prepared_parts.glob("part-*/part.json"))) == 2
    assert run(monkeypatch, "merge", prepared_parts) == 0
    assert (prepared_parts / "forest.safetensors").is_file()
    assert not list(prepared_parts.glob("part-*"))


@pytest.mark.parametrize(
    ("scene", "options", "said"),
    [
        ("cornell", ["--minutes", 1], "--part: takes --quality, and neither --minutes nor --psnr"),
        ("cornell", ["--region", "reachable"], "--region reachable: parts prepare the region near only"),
        ("cornell", ["--clamp-indirect", 5], "--clamp-indirect: has no influence on parts"),
        ("cornell", ["--size", 64, 64], "--size: has no influence on parts"),
        ("cornell", ["-o", "f.forest"], "--output: has no influence on parts"),
        ("room-moving", [], "something moves in it; prepare it on one machine, without --part"),
    ],
)
def test_what_parts_cannot_prepare_is_refused_before_any_work(
    scene, options, said, monkeypatch, tmp_path, capsys
):
    common = ["prepare", scene, "--part", "1/2", "--shared", tmp_path / "p"]
    assert run(monkeypatch, *common, *options) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "p").exists()


def test_frames_of_elsewhere_get_no_receipt_by_a_merge(parts, monkeypatch, tmp_path_factory, capsys):
    assert run(monkeypatch, "merge", parts) == 0
    monkeypatch.setenv("HYBRID_HOME", str(tmp_path_factory.mktemp("other")))
    assert run(monkeypatch, "merge", parts) == 2
    assert "not captured here" in capsys.readouterr().err
    assert not has_receipt(read_frame_set(parts))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--part", "0/4"], "--part 0/4: must be I/N"),
        (["--part", "x"], "--part x: must be I/N"),
        (["--part", "all/4"], "--part all/4: all parts at once require --ray"),
        (["--ray", "local"], "--ray: requires --part all/N"),
        (["--ray", "local", "--part", "1/4"], "--ray: requires --part all/N"),
        (["--ray", "local", "--part", "all/0"], "--part 1/0: must be I/N"),
    ],
)
def test_what_cannot_be_a_part_is_refused_before_any_work(options, said, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, *CAPTURE, tmp_path / "f", *options) == 2
    assert f"hybrid: {said}" in capsys.readouterr().err
    assert not (tmp_path / "f").exists()


def test_missing_ray_is_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert run(monkeypatch, *CAPTURE, tmp_path / "f", "--ray", "local", "--part", "all/2") == 2
    said = "hybrid: --ray requires Ray: pip install 'foveated-hybrid-renderer[ray]'\n"
    assert capsys.readouterr().err == said


def test_merging_what_holds_no_parts_is_refused(monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "merge", tmp_path) == 2
    assert f"{tmp_path}: holds no parts" in capsys.readouterr().err


def test_parts_of_another_kind_are_refused(parts, monkeypatch, capsys):
    for file in parts.glob("*/part.json"):
        file.write_text(file.read_text().replace('"capture"', '"later"'))
    assert run(monkeypatch, "merge", parts) == 2
    assert "holds parts of later, which this version cannot merge" in capsys.readouterr().err


@pytest.mark.parametrize(
    "given",
    [
        ["--part", "all/8", "--ray", "local", "--json", "a.json"],
        ["--part=all/8", "--ray=local", "--json=a.json"],
    ],
)
def test_each_part_gets_the_arguments_of_the_command(given):
    command = ["sweep", "room", *given[:2], "--spp", "2", *given[2:], "--shared", "all"]
    expected = ["sweep", "--part", "3/8", "room", "--spp", "2", "--shared", "all"]
    assert arguments_of(Part(3, 8), command) == expected


class CrashError(Exception):
    """What Ray raises when a worker died more often than its task may be begun again."""


class StandIn:
    """Begins tasks as Ray does, one after the other in this process; `deaths` of their workers come first."""

    exceptions = SimpleNamespace(
        WorkerCrashedError=CrashError, NodeDiedError=CrashError, OutOfMemoryError=CrashError
    )

    def __init__(self, deaths: int = 0):
        self.deaths, self.ended = deaths, False

    def init(self, address: str, **options: object) -> None:
        if address != "local":
            raise ConnectionError("nobody there")

    def shutdown(self) -> None:
        self.ended = True

    def nodes(self) -> list[dict]:
        return [{"Alive": True, "Resources": {"CPU": 2.0}}]

    def remote(self, max_retries: int, **options: object):
        def task(function):
            def begin(*arguments):
                return partial(self._result, function, arguments, max_retries)

            return SimpleNamespace(options=lambda name: SimpleNamespace(remote=begin))

        return task

    def _result(self, function, arguments, retries: int) -> object:
        for _ in range(retries + 1):
            try:
                return function(*arguments)
            except CrashError:
                continue
        raise CrashError("the worker died")

    def wait(self, waiting: list):
        return waiting[:1], waiting[1:]

    def get(self, task: partial) -> object:
        return task()


@pytest.fixture
def on_stand_in(monkeypatch, tmp_path):
    """Captures in two parts on a stand-in of Ray, whose workers die some times after two frames."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    share = capture_parts.render_share

    def capture(deaths: int, *options: object, address: str = "local") -> tuple[int, StandIn]:
        ray = StandIn(deaths)

        def dying(scene, folder, document, progress, *rest):
            ray.deaths -= 1
            if ray.deaths >= 0:
                number = count(1)

                def progress(done, total):
                    if next(number) == 2:
                        raise CrashError

            share(scene, folder, document, progress, *rest)

        monkeypatch.setattr(capture_parts, "render_share", dying)
        monkeypatch.setitem(sys.modules, "ray", ray)
        common = [*CAPTURE, "parts", *OPTIONS, "--integrator", "path", "--part", "all/2"]
        return run(monkeypatch, *common, "--ray", address, *options), ray

    return capture


def test_parts_are_begun_again_as_often_as_workers_die_and_merged(on_stand_in, two_parts, tmp_path):
    code, ray = on_stand_in(3, "--json", "m.json")
    assert (code, ray.ended) == (0, True)
    frames = {path.name: path.read_bytes() for path in two_parts.glob("*/frames/*")}
    assert {path.name: path.read_bytes() for path in (tmp_path / "parts" / "frames").iterdir()} == frames
    assert json.loads((tmp_path / "m.json").read_text())["views"] == 4


def test_workers_that_die_all_the_time_end_in_one_line(on_stand_in, tmp_path, capsys):
    code, ray = on_stand_in(100)
    assert (code, ray.ended) == (2, True)
    assert "hybrid: --ray local: part 1 of 2: the worker died\n" in capsys.readouterr().err
    assert not (tmp_path / "parts" / "transforms.json").exists()
    # It goes on where they died.
    assert on_stand_in(0)[0] == 0


def test_a_part_that_is_refused_ends_in_its_line(on_stand_in, capsys):
    assert on_stand_in(0, "--sensor", "nowhere")[0] == 2
    assert re.search(r"^hybrid: part 1 of 2: .*nowhere", capsys.readouterr().err, re.MULTILINE)


def test_a_cluster_that_does_not_answer_is_named(on_stand_in, capsys):
    assert on_stand_in(0, address="10.0.0.1:6379")[0] == 2
    assert "--ray 10.0.0.1:6379: no cluster answers (nobody there)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("machines", "is_timed", "expected"),
    [
        ([{"CPU": 8.0}, {"CPU": 4.0}, {"memory": 1.0}], True, {"num_cpus": 4.0}),
        ([{"CPU": 8.0}, {"CPU": 4.0}], False, {"num_cpus": 1}),
        ([{"CPU": 8.0}, {"CPU": 4.0, "GPU": 2.0}], True, {"num_gpus": 1}),
    ],
)
def test_parts_that_measure_times_share_no_machine(machines, is_timed, expected):
    gone = {"Alive": False, "Resources": {"CPU": 1.0}}
    assert _claim([gone, *({"Alive": True, "Resources": one} for one in machines)], is_timed) == expected


def workers_of(cache: Path) -> list[int]:
    """Processes of Ray that do a part with a cache folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            title = (process / "cmdline").read_bytes()
            if (
                title.startswith(b"ray::hybrid part")
                and str(cache).encode() in (process / "environ").read_bytes()
            ):
                found.append(int(process.name))
        except OSError:
            continue
    return found


@extreme(
    "a worker of Ray that is killed",
    given="two parts of a capture on two workers, one of them killed after its first frame",
    expected="the same bytes as without Ray",
)
def test_a_part_whose_worker_is_killed_is_done_again(monkeypatch, tmp_path, got):
    pytest.importorskip("ray", reason="needs the extra `ray`")
    if not Path("/proc/self/environ").exists():
        pytest.skip("needs /proc, to find the workers")
    options = [*OPTIONS, "--integrator", "path"]
    assert run(monkeypatch, *CAPTURE, tmp_path / "whole", *options) == 0
    folder, killed, over = tmp_path / "parts", [], threading.Event()

    def kill() -> None:
        while not over.is_set() and not list(folder.glob("part-*/frames/*.exr")):
            time.sleep(0.002)
        for worker in workers_of(home())[:1]:
            os.kill(worker, signal.SIGKILL)
            killed.append(worker)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        code = run(monkeypatch, *CAPTURE, folder, *options, "--ray", "local", "--part", "all/2")
    finally:
        over.set()
        killer.join()
    assert code == 0
    assert len(killed) == 1
    assert contents(folder) == contents(tmp_path / "whole")
    got("1 killed, the same bytes")
