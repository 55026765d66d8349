"""`mesh_from_points` and `reconstruct` from Python: their examples, frames and units, and what is refused."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import capture2vr
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.mesh import nouns as mesh_nouns
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.errors import BadInput
from capture2vr.library import pipeline_call
from capture2vr.library import reconstruct as reconstruct_module
from capture2vr.library import reconstruction as reconstruction_module
from capture2vr.library import source as source_module
from capture2vr.library.reconstruct import mesh_from_points, reconstruct
from capture2vr.library.reconstruction import Reconstruction
from capture2vr.library.source import opened, read_capture
from tests.support.clouds import sphere_points
from tests.support.doctests import run_examples

FAR = np.array([500_000.0, 5_000_000.0, 0.0])  # coordinates of a map, in metres


@pytest.fixture(scope="module")
def made() -> Reconstruction:
    return reconstruct(sphere_points(600), np.full((600, 3), 200, np.uint8), preset="draft", resolution=24)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.save(tmp_path / "sphere.npy", sphere_points(600))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("module", [source_module, reconstruct_module, reconstruction_module, mesh_nouns])
def test_the_examples_of_the_docstrings(module: Any, made: Reconstruction, folder: Path) -> None:
    assert run_examples(module, sphere=sphere_points(600), made=made, folder=folder, np=np) >= 2


@pytest.mark.slow
def test_a_reconstruction_has_meshes_levels_certificate_and_files(made: Reconstruction, tmp_path: Path) -> None:
    assert made.mesh is made.preview
    assert made.refined is None
    assert made.mesh.vertices.dtype == np.float64
    assert made.mesh.faces.dtype == np.int64
    assert made.mesh.rgb is not None
    assert abs(int(np.median(made.mesh.rgb)) - 200) <= 2
    assert [level[:4] for level in made.levels] == [b"glTF"] * 3
    assert made.textures == ()
    assert 0 < made.certificate["held_out_mean"] < 0.05
    assert any("which way is up" in warning for warning in made.warnings)
    assert np.allclose(np.ptp(made.mesh.vertices, axis=0), 2, atol=0.1), "the units of the points"
    saved = made.save(tmp_path / "new" / "out")
    assert {path.name for path in saved.iterdir()} == {*made.files, "manifest.json"}
    assert (saved / "lod0.glb").read_bytes() == made.levels[0]
    assert json.loads((saved / "manifest.json").read_text())["preset"] == "draft"
    with pytest.raises(BadInput, match="is a file"):
        made.save(saved / "mesh.ply")


@pytest.mark.slow
def test_a_mesh_lies_where_its_points_do_and_progress_is_told() -> None:
    stages: list[str] = []
    xyz = sphere_points(600) + FAR
    mesh = mesh_from_points(xyz, None, "draft", resolution=24, progress=lambda each: stages.append(each.stage))
    assert abs(np.linalg.norm(mesh.vertices - FAR, axis=1) - 1).max() < 0.2
    assert mesh.rgb is None
    assert list(dict.fromkeys(stages))[:3] == ["POINT_CLOUD", "FITTING", "EXTRACTING"]


@pytest.mark.parametrize(
    ("xyz", "rgb", "said"),
    [
        (np.zeros((200, 2)), None, r"shape \(200, 2\)"),
        (np.zeros(3), None, r"shape \(3,\)"),
        ([[0, 0, 0], [1]], None, "numbers of the shape"),
        (np.full((200, 3), "a"), None, "numbers of the shape"),
        (np.zeros((200, 3)), None, "at the same position"),
        (np.eye(3), None, "only 3 points"),
        (np.full((200, 3), np.nan), None, "not finite"),
        (np.ones((200, 3)) * np.arange(200)[:, None], None, "on one straight line"),
        (sphere_points(200), np.zeros((199, 3), np.uint8), r"\(200, 3\), one row to a point"),
    ],
)
def test_points_that_are_no_surface_are_refused_with_a_reason(xyz: Any, rgb: Any, said: str) -> None:
    with pytest.raises(capture2vr.CaptureError, match=said) as refused:
        mesh_from_points(xyz, rgb, "draft")
    assert refused.value.hints


@pytest.mark.slow
def test_values_that_do_not_fit_are_refused_before_any_work(folder: Path) -> None:
    sphere = sphere_points(200)
    for wrong, said in (
        ({"preset": "magic"}, "there is no preset 'magic'"),
        ({"preset": "draft", "target": "toaster"}, "there is no target 'toaster'"),
        ({"preset": "draft", "box": (0, 0, 2, 1)}, "box: "),
        ({"preset": "draft", "edits": {"crops": 1}}, "edits: "),
        ({"device": "cuda:99"}, "cuda:99"),
    ):
        with pytest.raises(capture2vr.Capture2vrError, match=said):
            reconstruct(sphere, **wrong)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="no such file"):
        reconstruct(folder / "nothing.ply")
    with pytest.raises(BadInput, match="colours go with points in memory"):
        reconstruct(folder / "sphere.npy", np.zeros((600, 3)))


def test_an_archive_is_unpacked_for_as_long_as_it_is_used(folder: Path, tmp_path: Path) -> None:
    shutil.make_archive(str(tmp_path / "scan"), "zip", folder, "sphere.npy")
    with opened(tmp_path / "scan.zip") as capture:
        assert capture.cloud is not None
        assert len(capture.cloud.xyz) == 600
    with opened(capture) as same:
        assert same is capture
    assert isinstance(read_capture(str(folder / "sphere.npy")), Capture)


def test_a_mesh_of_others_is_made_or_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]), np.array([[255, 0, 0]] * 3, np.uint8))
    assert mesh.to_trimesh().visual.vertex_colors[0].tolist() == [255, 0, 0, 255]
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(BadInput, match="pip install open3d"):
        mesh.to_open3d()


def test_models_and_generator_are_those_of_the_call(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    class AskedError(Exception):
        """Instead of the work: with what the pipeline was called."""

    def called(*given: Any, **_: Any) -> Any:
        raise AskedError(given[3])

    monkeypatch.setattr(pipeline_call, "run", called)
    monkeypatch.setenv("EDGE_MODELS", "elsewhere")
    for models, expected in ((folder / "models", folder / "models"), ("", None)):
        with pytest.raises(AskedError) as asked:
            reconstruct(sphere_points(600), preset="draft", models=models, generator="http://127.0.0.1:9")
        resources = asked.value.args[0]
        assert (resources.models and resources.models.folder) == expected
        assert resources.generator is not None
