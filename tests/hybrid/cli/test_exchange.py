"""`hybrid export` and `hybrid import`."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.eye.display import Display
from compose.image.colour import srgb_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.cli.exchange import export_file, import_file
from hybrid.measure.perceptual_metrics import has_fovvideovdp
from hybrid.render.forest_attachments import views_of
from hybrid.render.level_quality import quality_of
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.dataset.posed_layouts import read_posed_folder
from pathtrace.gltf import document
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest, save_forest
from splat.io.ply import load_ply
from splat.lod.forest_renderer import ForestRenderer
from splat.model.gaussians import Blending
from splat.model.points import in_world
from tests.conftest import real_file
from tests.hybrid.command import run
from tests.pathtrace.gltf.building import Building, bending_tube
from tests.splat.raster.plain_3dgs import picture
from tests.splat.samples import equal

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.mark.parametrize(("options", "number"), [(["--layer", 1], 1), (["--layer", 2], 2), ([], 2)])
def test_a_layer_is_exported_by_its_number(options, number, made, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.ply", *options) == 0
    forest = load_forest(made / "box.forest")
    # Other programs know no coordinates but the world's.
    gaussians = in_world(forest.layers[number - 1].gaussians, forest.place)
    found = load_ply(tmp_path / "a.ply")
    # They are fitted to other programs, but remain where they are.
    assert found.blending is Blending.DISPLAY
    assert (found.means - gaussians.means).abs().max() < 0.1
    assert not torch.equal(found.sh, gaussians.all_turning().sh)
    said = f"a.ply: layer {number}, {len(gaussians):,} Gaussians, degree 1, "
    assert re.search(
        re.escape(said) + r"\d+\.\d dB from the forest's own pictures\n$", capsys.readouterr().out
    )


def test_a_forest_that_does_not_tell_its_views_is_exported(made, monkeypatch, tmp_path):
    forest = load_forest(made / "box.forest")
    save_forest(tmp_path / "f", replace(forest, attached={}))
    assert run(monkeypatch, "export", tmp_path / "f", tmp_path / "a.ply") == 0
    assert len(load_ply(tmp_path / "a.ply")) == len(forest.finest)


def test_what_is_exported_looks_like_the_forest(made, monkeypatch, tmp_path):
    """By the rules of 3D Gaussian splatting, from where nobody looked before."""
    monkeypatch.setattr("splat.training.picture_fit._STEPS", 60)
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.ply") == 0
    forest = load_forest(made / "box.forest")
    view = views_of(forest)[1].moved_right(0.05)
    image = ForestRenderer(device_arrays(), forest).render_layer(view, len(forest.counts)).numpy()
    error = srgb_from_radiance(image) - picture(load_ply(tmp_path / "a.ply"), view).clamp(0, 1).numpy()
    assert -10 * np.log10(np.square(error).mean()) > 35


def test_an_exported_forest_is_imported_and_fits_any_scene(made, monkeypatch, tmp_path, capsys):
    export_file(made / "box.forest", tmp_path / "a.ply")
    import_file(tmp_path / "a.ply", tmp_path / "b.forest")
    imported = load_forest(tmp_path / "b.forest")
    assert imported.counts == (len(load_forest(made / "box.forest").finest),)
    assert (imported.scene_name, imported.scene_hash) == ("a", "")
    assert imported.hierarchy is not None
    assert "b.forest: " in capsys.readouterr().out
    common = ["render", "cornell", "--forest", tmp_path / "b.forest", "--size", 40, 30]
    assert run(monkeypatch, *common, "-o", tmp_path / "b.png") == 0
    facts = tmp_path / "few.json"
    few = ["--gaussians", 100, "-o", tmp_path / "few.png", "--json", facts]
    assert run(monkeypatch, *common, *few) == 0
    assert json.loads(facts.read_text())["gaussians"] == 100


def test_a_real_ply_goes_through_import(monkeypatch, tmp_path):
    source = real_file("splats/kacytran_try_it7000.ply")
    assert run(monkeypatch, "import", source, tmp_path / "k.forest", "--precision", "float32") == 0
    assert load_forest(tmp_path / "k.forest").finest.blending is Blending.DISPLAY
    assert run(monkeypatch, "export", tmp_path / "k.forest", tmp_path / "k.ply") == 0
    # A forest keeps its Gaussians in an order of its own.
    found, expected = load_ply(tmp_path / "k.ply"), load_ply(source)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        ours, theirs = (getattr(gaussians, name).sort(dim=-1).values for gaussians in (found, expected))
        assert torch.equal(ours, theirs)


def test_a_gltf_file_is_imported_as_a_scene_that_moves(monkeypatch, tmp_path, capsys):
    building = Building()
    bending_tube(building)
    file = building.save(tmp_path / "tube.GLB")
    assert run(monkeypatch, "import", file, tmp_path / "tube", "--fps", 12, "--animation", "bend") == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].endswith("scene.xml: 128 triangles; 0 move rigidly, 1 deform, in 1 s")
    assert "the file has no lights; light comes from all directions" in said
    scene = load_scene(tmp_path / "tube" / "scene.xml")
    assert scene.name == "tube"
    assert scene.moving is not None
    assert len(list((tmp_path / "tube/meshes").iterdir())) == 14
    assert run(monkeypatch, "import", file, tmp_path / "tube") == 2
    assert capsys.readouterr().err.endswith("exists already; name another folder, or remove it\n")


def test_a_gltf_file_in_which_nothing_moves_says_so(monkeypatch, tmp_path, capsys):
    building = Building()
    bending_tube(building)
    del building.tree["animations"]
    parsed, parse = [], document.parse_json
    monkeypatch.setattr(document, "parse_json", lambda text: parsed.append(text) or parse(text))
    assert run(monkeypatch, "import", building.save(tmp_path / "a.gltf"), tmp_path / "still") == 0
    assert len(parsed) == 1
    assert "; nothing moves\n" in capsys.readouterr().out
    assert not (tmp_path / "still/scene.motion.json").exists()


@pytest.mark.parametrize("option", [("--fps", 24), ("--animation", "walk")])
def test_options_of_gltf_are_refused_for_ply(option, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "import", tmp_path / "a.ply", tmp_path / "a.forest", *option) == 2
    assert "--fps, --animation: only of scenes in .glb and .gltf files" in capsys.readouterr().err


def test_a_name_that_tells_no_format_is_refused(made, monkeypatch, tmp_path, capsys):
    for name in ("a.xyz", "a"):
        assert run(monkeypatch, "export", made / "box.forest", tmp_path / name) == 2
        assert f"{name}: must end in .glb, .ply" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_other_formats_are_exported_and_imported(made, monkeypatch, tmp_path):
    pytest.importorskip("gaussforge", reason="gaussforge is not installed")
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.spz") == 0
    assert run(monkeypatch, "import", tmp_path / "a.spz", tmp_path / "b.forest") == 0
    assert load_forest(tmp_path / "b.forest").counts == (len(load_forest(made / "box.forest").finest),)


def test_gaussians_go_out_and_in_as_gltf(made, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.glb") == 0
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.ply") == 0
    assert (
        run(monkeypatch, "import", tmp_path / "a.glb", tmp_path / "b.forest", "--precision", "float32") == 0
    )
    assert run(monkeypatch, "export", tmp_path / "b.forest", tmp_path / "b.ply") == 0
    found, expected = load_ply(tmp_path / "b.ply"), load_ply(tmp_path / "a.ply")
    for name, bound in (("means", 1e-6), ("log_scales", 1e-5), ("opacity_logits", 1e-3)):
        ours, theirs = (getattr(gaussians, name).sort(dim=-1).values for gaussians in (found, expected))
        assert (ours - theirs).abs().max() < bound
    capsys.readouterr()
    options = ["--animation", "bend"]
    assert run(monkeypatch, "import", tmp_path / "a.glb", tmp_path / "c.forest", *options) == 2
    assert "only of scenes in .glb and .gltf files" in capsys.readouterr().err


def test_frames_are_exported_as_a_data_set_of_colmap(made, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "export", made / "frames", tmp_path / "out") == 0
    frames, found = read_frame_set(made / "frames"), read_posed_folder(tmp_path / "out")
    said = f"out: {len(frames.entries)} images, {len(found.points):,} points\n"
    assert capsys.readouterr().out.endswith(said)
    assert [image.held_out for image in found.images] == [entry.held_out for entry in frames.entries]
    assert run(monkeypatch, "export", made / "frames", tmp_path / "b", "--layer", 1) == 2
    assert "--layer: only of a forest" in capsys.readouterr().err


def test_all_levels_of_a_forest_are_exported_as_streamed_sog(made, monkeypatch, tmp_path, capsys):
    """Layers of a trained forest, the finest first; of an imported one, what its hierarchy makes of it."""
    pytest.importorskip("gaussforge")
    forest = load_forest(made / "box.forest")
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "all" / "lod-meta.json") == 0
    index = json.loads((tmp_path / "all" / "lod-meta.json").read_text())
    assert index["counts"] == [*reversed(forest.counts)]
    export_file(made / "box.forest", tmp_path / "a.ply")
    import_file(tmp_path / "a.ply", tmp_path / "b.forest")
    assert run(monkeypatch, "export", tmp_path / "b.forest", tmp_path / "b" / "lod-meta.json") == 0
    counts = json.loads((tmp_path / "b" / "lod-meta.json").read_text())["counts"]
    assert counts[0] == forest.counts[-1]
    assert 1 < len(counts) <= 4
    assert "lod-meta.json: levels of " in capsys.readouterr().out


@pytest.mark.parametrize("imported", [False, True])
def test_levels_of_detail_are_fitted_and_stored(imported, made, monkeypatch, tmp_path, capsys):
    source, own, facts = made / "box.forest", tmp_path / "own.forest", tmp_path / "facts.json"
    if imported:
        export_file(source, tmp_path / "a.ply")
        source = tmp_path / "b.forest"
        import_file(tmp_path / "a.ply", source)
    before = source.read_bytes()
    (tmp_path / "small.json").write_text('{"width": 64, "height": 48, "fov": 20}')
    small = "--display", tmp_path / "small.json"
    assert run(monkeypatch, "levels", source, "-o", own, "--steps", 40, *small, "--json", facts) == 0
    found = json.loads(facts.read_text())
    assert found["psnr"] >= found["psnr_before"] > 10
    stored = load_forest(own)
    assert len(stored.hierarchy) == found["inner"] > 0
    assert equal(stored.nodes.gaussians, load_forest(source).nodes.gaussians)
    said = capsys.readouterr().out
    assert "dB from pictures of the finest layer" in said
    assert source.read_bytes() == before
    quality = quality_of(stored)
    if has_fovvideovdp():
        assert 0 <= found["jod_error"] < 2
        assert f"known to {found['jod_error']:.2f} JOD" in said
        assert quality.display == Display(64, 48, 20.0)
        # What levels look like is no part of what the forest is.
        assert stored.digest() == load_forest(source).digest()
    else:
        assert quality is None
        assert "their quality is not known: JOD needs FovVideoVDP" in said
