"""Files that a scene loads indirectly belong to its hash; what a scene's XML may not do."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import pytest

from compose.base.errors import UserError
from pathtrace.scene.loading import Source, load_mitsuba
from pathtrace.scene.scene import files_of_scene, load_scene
from pathtrace.scene.scene_xml import References, parse_xml, read_description
from tests.extremes import extreme

OBJ = "v 0 0 0\nv 1 0 0\nv {} 1 0\nf 1 2 3\n"
MESH = '<shape type="obj"><string name="filename" value="{}"/></shape>'
AROUND = '<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"/>{}</scene>'


def scene(folder: Path, content: str, files: dict[str, str]) -> Path:
    """A scene's file beside others."""
    for name, text in {"scene.xml": AROUND.format(content), **files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "scene.xml"


def fingerprint(file: Path) -> str:
    return read_description(file).fingerprint


PART = '<scene version="3.0.0">{}</scene>'
INDIRECT = {
    "include": ('<include filename="part.xml"/>', {"part.xml": PART.format(MESH.format("m.obj"))}),
    "include below": (
        '<include filename="sub/part.xml"/>',
        {"sub/part.xml": PART.format(MESH.format("m.obj"))},
    ),
    "include of an include": (
        '<include filename="a.xml"/>',
        {"a.xml": PART.format('<include filename="b.xml"/>'), "b.xml": PART.format(MESH.format("m.obj"))},
    ),
    "include beside an include": (
        '<include filename="sub/a.xml"/>',
        {
            "sub/a.xml": PART.format('<include filename="b.xml"/>'),
            "sub/b.xml": PART.format(MESH.format("m.obj")),
        },
    ),
    "include in a group": (
        '<shape type="shapegroup" id="g"><include filename="part.xml"/></shape>'
        '<shape type="instance"><ref id="g"/></shape>',
        {"part.xml": PART.format(MESH.format("m.obj"))},
    ),
    "parameter": ('<default name="dir" value="sub"/>' + MESH.format("$dir/../m.obj"), {"sub/x": ""}),
    "parameter of a parameter": (
        '<default name="d" value="m"/><default name="dir" value="$d.obj"/>' + MESH.format("$dir"),
        {},
    ),
    "parameter from an include": (
        '<include filename="part.xml"/>' + MESH.format("$f"),
        {"part.xml": PART.format('<default name="f" value="m.obj"/>')},
    ),
    "included by a parameter": (
        '<default name="p" value="part.xml"/><include filename="$p"/>',
        {"part.xml": PART.format(MESH.format("m.obj"))},
    ),
    "parameter as a name": (
        '<default name="n" value="filename"/><shape type="obj"><string name="$n" value="m.obj"/></shape>',
        {},
    ),
    "search folder": ('<path value="sub"/>' + MESH.format("../m.obj"), {"sub/x": ""}),
    "search folder later": (MESH.format("n.obj") + '<path value="sub"/>', {"sub/n.obj": "{}"}),
    "search folder by a parameter": (
        '<default name="d" value="sub"/><path value="$d"/>' + MESH.format("n.obj"),
        {"sub/n.obj": "{}"},
    ),
}


@pytest.mark.parametrize("name", INDIRECT)
def test_a_file_that_is_loaded_indirectly_belongs_to_the_hash(name, backend, tmp_path):
    content, files = INDIRECT[name]
    meshes = [file for file in files if file.endswith("n.obj")] or ["m.obj"]
    found = set()
    for x in (0.0, 0.5):
        file = scene(tmp_path, content, {**files, meshes[0]: OBJ.format(x)})
        # Mitsuba does load it.
        assert load_mitsuba(Source(str(file), file.read_text(), file.parent)).shapes()
        found.add(fingerprint(file))
    assert len(found) == 2


@extreme(
    "scenes that differ in an indirect file",
    given="12 ways by which includes, parameters and search folders lead to a mesh, and a spectrum's file",
    expected="another hash for another content, each time",
)
def test_hashes_tell_all_indirect_files_apart(tmp_path, got):
    differ = 0
    for number, (content, files) in enumerate(INDIRECT.values()):
        meshes = [file for file in files if file.endswith("n.obj")] or ["m.obj"]
        found = {
            fingerprint(scene(tmp_path / f"{number}", content, {**files, meshes[0]: OBJ.format(x)}))
            for x in (0.0, 0.5)
        }
        differ += len(found) == 2
    spectrum = '<bsdf type="diffuse"><spectrum name="reflectance" filename="a.spd"/></bsdf>'
    found = {fingerprint(scene(tmp_path / "s", spectrum, {"a.spd": text})) for text in ("400 0.5", "400 0.6")}
    assert got(differ + (len(found) == 2)) == len(INDIRECT) + 1


BALL = '<shape type="sphere"><float name="radius" value="$r"/></shape>'
DEFAULT = '<default name="r" value="{}"/>'
INCLUDE = '<include filename="part.xml"/>'
# Content of the scene and of what it includes, and the radius of the ball; None where Mitsuba refuses it.
PARAMETERS = {
    "of the including file": (DEFAULT.format(2) + INCLUDE, BALL, 2),
    "of the included file": (INCLUDE, DEFAULT.format(3) + BALL, 3),
    "of both": (DEFAULT.format(2) + INCLUDE, DEFAULT.format(3) + BALL, 2),
    "defined after the include": (INCLUDE + DEFAULT.format(2), BALL, None),
    "of both, one after the include": (INCLUDE + DEFAULT.format(2), DEFAULT.format(3) + BALL, 3),
    "of the included file, used after it": (INCLUDE + BALL, DEFAULT.format(3), 3),
    "of a file around both": (DEFAULT.format(2) + INCLUDE, '<include filename="ball.xml"/>', 2),
    "of the file between": (INCLUDE, DEFAULT.format(4) + '<include filename="ball.xml"/>', 4),
    "of a file before": (INCLUDE + '<include filename="ball.xml"/>', DEFAULT.format(4), 4),
    "of a parameter": ('<default name="d" value="5"/>' + DEFAULT.format("$d") + INCLUDE, BALL, 5),
    "in the name of the file": (
        '<default name="p" value="part"/>' + DEFAULT.format(2) + '<include filename="$p.xml"/>',
        BALL,
        2,
    ),
    "of an integrator": (
        '<default name="integrator" value="path"/>' + DEFAULT.format(2) + INCLUDE,
        '<integrator type="$integrator"/>' + BALL,
        2,
    ),
}


@pytest.mark.parametrize("name", PARAMETERS)
def test_included_files_have_the_parameters_that_mitsuba_gives_them(name, backend, tmp_path):
    content, included, radius = PARAMETERS[name]
    files = {"part.xml": PART.format(included), "ball.xml": PART.format(BALL)}
    file = scene(tmp_path, content, files)
    if radius is None:
        with pytest.raises(RuntimeError, match="undefined parameter"):
            mi.load_file(str(file))
        with pytest.raises(UserError, match=r"undefined parameter: \$r"):
            load_scene(file)
        return
    sizes = [each.bbox().max.x for each in (mi.load_file(str(file)), load_scene(file).mitsuba)]
    assert sizes == [radius, radius]


def test_parameters_of_the_including_file_belong_to_the_hash(tmp_path):
    files = {"part.xml": PART.format(BALL)}
    found = {fingerprint(scene(tmp_path, DEFAULT.format(radius) + INCLUDE, files)) for radius in (2, 3)}
    assert len(found) == 2


def test_an_include_itself_belongs_to_the_hash(tmp_path):
    found = {
        fingerprint(scene(tmp_path, '<include filename="p.xml"/>', {"p.xml": PART.format(shape)}))
        for shape in ("", '<shape type="sphere"/>')
    }
    assert len(found) == 2


def test_files_of_the_working_folder_count_where_the_scene_has_none(tmp_path, monkeypatch):
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    file = scene(tmp_path / "s", MESH.format("m.obj"), {})
    alone = fingerprint(file)
    (tmp_path / "cwd" / "m.obj").write_text("x")
    assert fingerprint(file) != alone
    (tmp_path / "s" / "m.obj").write_text("y")
    own = fingerprint(file)
    (tmp_path / "cwd" / "m.obj").write_text("z")
    assert fingerprint(file) == own


LAUGHS = "".join(f'<!ENTITY l{n + 1} "{f"&l{n};" * 10}">' for n in range(9))
BILLION = f'<!DOCTYPE scene [<!ENTITY l0 "ha">{LAUGHS}]><scene version="3.0.0">&l9;</scene>'
DOUBLING = "".join(f'<default name="p{n + 1}" value="$p{n}x$p{n}x"/>' for n in range(60))


@pytest.mark.parametrize(
    ("content", "files", "said"),
    [
        pytest.param(
            BILLION,
            {},
            "declares XML entities",
            id="laughs",
            marks=extreme(
                "billion laughs", given="ten entities of ten each, 10^9 in all", expected="refused"
            ),
        ),
        pytest.param(
            BILLION.encode("utf-16"),
            {},
            "declares XML entities",
            id="laughs-16",
            marks=extreme(
                "billion laughs in UTF-16", given="the same in another encoding", expected="refused"
            ),
        ),
        pytest.param(
            '<!DOCTYPE s [<!ENTITY x SYSTEM "file:///etc/passwd">]><scene version="3.0.0">&x;</scene>',
            {},
            "declares XML entities",
            marks=extreme("XML entity of another file", given="/etc/passwd as an entity", expected="refused"),
        ),
        pytest.param(
            AROUND.format('<include filename="scene.xml"/>'),
            {},
            "too often, or in a loop",
            marks=extreme("include loop", given="a scene that includes itself", expected="refused"),
        ),
        pytest.param(
            AROUND.format('<include filename="0.xml"/>'),
            {
                f"{n}.xml": PART.format(f'<include filename="{n + 1}.xml"/>' * 2 if n < 13 else "")
                for n in range(14)
            },
            "too often, or in a loop",
            id="doubling",
            marks=extreme(
                "doubling includes", given="13 files, each includes the next twice", expected="refused"
            ),
        ),
        pytest.param(
            '<scene version="3.0.0">' + "<a>" * 100_000 + "</a>" * 100_000 + "</scene>",
            {},
            "nested more than 100 deep",
            id="deep",
            marks=extreme("deep XML", given="100,000 elements in one another", expected="refused"),
        ),
        pytest.param(
            AROUND.format('<default name="p0" value="m"/>' + DOUBLING + MESH.format("$p60")),
            {},
            "parameters stand for more than",
            id="parameters",
            marks=extreme("doubling parameters", given="60, each twice the one before", expected="refused"),
        ),
        ("<scene", {}, "not well-formed XML"),
        (b"\xff\xfe\x00", {}, "not well-formed XML"),
        (AROUND.format('<include filename="p.xml"/>'), {"p.xml": "<"}, "p.xml: not well-formed XML"),
    ],
)
def test_xml_that_would_take_unbounded_memory_is_refused(content, files, said, tmp_path, request):
    scene(tmp_path, "", files)
    content = content.encode() if isinstance(content, str) else content
    (tmp_path / "scene.xml").write_bytes(content)
    with pytest.raises(UserError, match=said) as caught:
        load_scene(tmp_path / "scene.xml")
    assert str(caught.value).isprintable()
    if request.node.get_closest_marker("extremes"):
        request.getfixturevalue("got")(str(caught.value).replace(str(tmp_path), ""))


def with_own_code(folder: Path, kind: str, where: str) -> Path:
    """A scene of a plugin that lies beside it, or in another place where Mitsuba would look for it."""
    shape = f'<shape type="sphere"><bsdf type="{kind}"/></shape>'
    content, files = shape, {"plugins/its_own.so": "", "its_own.so": ""}
    if where == "include":
        content, files["p.xml"] = '<include filename="p.xml"/>', PART.format(shape)
    elif where == "search folder":
        content, files = '<path value="sub"/>' + shape, {"sub/plugins/its_own.so": "", "sub/its_own.so": ""}
    elif where == "parameter":
        content = f'<default name="k" value="{kind}"/>' + shape.replace(kind, "$k")
    return scene(folder, content, files)


@pytest.mark.parametrize("kind", ["its_own", "../its_own", "/its_own", "$undefined"])
@pytest.mark.parametrize("where", ["scene", "include", "search folder", "parameter"])
def test_a_scene_brings_no_code_of_its_own(kind, where, backend, tmp_path):
    """Mitsuba would load the library, which runs its code."""
    with pytest.raises(UserError, match="a scene may not bring its own code"):
        load_scene(with_own_code(tmp_path, kind, where))


@extreme(
    "scenes with native code",
    given="plugins/its_own.so beside a scene, an include, in a search folder; types that are paths",
    expected="refused, the library not loaded",
)
def test_code_beside_a_scene_is_refused(backend, tmp_path, got):
    kinds, places = ("its_own", "../its_own", "/its_own"), ("scene", "include", "search folder", "parameter")
    for kind in kinds:
        for where in places:
            with pytest.raises(UserError, match="a scene may not bring its own code") as caught:
                load_scene(with_own_code(tmp_path / kind.strip("./") / where, kind, where))
    got(f"{len(kinds) * len(places)} refused, the last: {caught.value}".replace(str(tmp_path), ""))


@pytest.mark.parametrize("in_working_folder", [False, True])
def test_mitsubas_own_plugins_come_before_others_of_their_name(
    in_working_folder, backend, tmp_path, monkeypatch
):
    """A library that is empty cannot be loaded: where it is tried, the scene is refused."""
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    place = "../cwd/plugins" if in_working_folder else "plugins"
    # Types that nothing else in the tests has loaded yet.
    kinds = ("bsplinecurve", "retarder", "sggx", "polarizer", "circular", "moment", "stokes")
    shape = '<shape type="sphere"><bsdf type="polarizer"/></shape>'
    load_scene(scene(tmp_path / "s", shape, {f"{place}/{kind}.so": "" for kind in kinds}))


def test_the_search_folders_are_as_before_once_a_scene_is_loaded(backend, tmp_path):
    folders = lambda: [str(mi.file_resolver()[i]) for i in range(len(mi.file_resolver()))]  # noqa: E731
    before = folders()
    load_scene(scene(tmp_path, '<shape type="sphere"/>', {}))
    assert folders() == before
    assert Path(before[0]) == Path(mi.__file__).parent


def test_a_search_folder_comes_before_the_working_folder(tmp_path, monkeypatch, backend):
    content = '<path value="meshes"/>' + MESH.format("m.obj")
    file = scene(tmp_path / "mine", content, {"meshes/m.obj": OBJ.format(5)})
    (tmp_path / "m.obj").write_text(OBJ.format(9))
    monkeypatch.chdir(tmp_path)
    assert load_scene(file).mitsuba.bbox().max.x == 5
    monkeypatch.chdir(tmp_path / "mine")
    assert load_scene("scene.xml").mitsuba.bbox().max.x == 5


def test_names_that_no_file_can_have_are_no_candidates(tmp_path):
    file = scene(tmp_path, MESH.format("n" * 5000), {})
    references = References(file, parse_xml(file))
    assert references.names == [("n" * 5000, tmp_path)]
    assert not list(references.candidates(*references.names[0]))
    assert fingerprint(file)


@pytest.mark.parametrize("name", INDIRECT)
def test_all_files_of_a_scene_are_known(tmp_path, name):
    content, files = INDIRECT[name]
    meshes = [file for file in files if file.endswith("n.obj")] or ["m.obj"]
    written = {**files, meshes[0]: OBJ.format(0)}
    source = scene(tmp_path, content, {**written, "unused.obj": OBJ, "scene.motion.json": "{}"})
    found = {file.resolve() for file in files_of_scene(source)}
    named = {"scene.xml", "scene.motion.json", *written} - {"sub/x"}
    assert found == {(tmp_path / one).resolve() for one in named}


def test_scene_text_has_no_files():
    assert files_of_scene(AROUND.format("")) == []
