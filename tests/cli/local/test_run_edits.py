"""`capture2vr run --edits`: the recipe cuts, turns and scales; the one of a manifest gives the same files again; a
lasso in one picture removes the thing that it goes round, and leaves the other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from capture2vr.cli.errors import BadInput
from capture2vr.cli.main import app
from tests.support.two_balls import BLUE_AT, RADIUS_M, RED_AT, line_around, picture_name, write_two_balls

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_pictures")]

RECIPE = {
    "crop": {"centre": [0, 0, 0.15], "size": [0.5, 0.5, 0.4]},
    "planes": [{"point": [0, 0, 0.02], "normal": [0, 0, 1]}],
    "up": [0, 0, 2],
    "length": {"start": [-0.1, 0, 0.1], "end": [0.1, 0, 0.1], "metres": 0.4},
    "fill": "none",
    "preset": "draft",
}


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud whose Z axis is up: a ball of radius 0.1 above a table."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(3_000, 3))
    ball = 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0, 0.13]
    table = np.column_stack([rng.uniform(-1, 1, (5_000, 2)), np.zeros(5_000)])
    path = tmp_path_factory.mktemp("scan") / "ball.xyz"
    np.savetxt(path, np.concatenate([ball, table]), fmt="%.5f")
    return path


def run(scan: Path, out: Path, recipe: Any, *more: str) -> dict[str, Any]:
    """The report of a run with a recipe."""
    file = out.with_suffix(".json")
    file.write_text(json.dumps(recipe))
    done = CliRunner().invoke(
        app, ["run", str(scan), "-o", str(out), "--edits", str(file), "--resolution", "32", *more]
    )
    if done.exception:
        raise done.exception
    assert done.exit_code == 0, done.output
    report: dict[str, Any] = json.loads((out / "report.json").read_text())
    return report


def test_the_recipe_of_the_manifest_gives_the_same_files(scan: Path, tmp_path: Path) -> None:
    report = run(scan, tmp_path / "one", RECIPE)
    assert report["size_m"] == pytest.approx([0.4, 0.4, 0.4], abs=0.04), "twice the ball, without the table"
    assert (report["scale_confidence"], report["preset"]) == ("estimated", "draft")
    assert report["capture"]["up"] == {"source": "person", "confidence": 1.0}
    to_asset = np.reshape(report["capture_to_asset"], (4, 4))
    assert np.allclose(to_asset[:3, :3] @ [0, 0, 1], [0, 2, 0])

    assert {name: report["edits"][name] for name in ("up", "fill", "preset")} == {
        "up": [0, 0, 2], "fill": "none", "preset": "draft",
    }  # fmt: skip
    again = run(scan, tmp_path / "two", report["edits"])
    assert again["edits"] == report["edits"]
    for name in ("lod0.glb", "mesh.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_cut_changes_no_size(scan: Path, tmp_path: Path) -> None:
    """`--longest` is of what was there before it: the table, of two metres and its diagonal."""
    recipe = {"crop": RECIPE["crop"], "planes": RECIPE["planes"], "preset": "draft"}
    report = run(scan, tmp_path / "out", recipe, "--longest", str(2**0.5))
    assert report["size_m"] == pytest.approx([0.1, 0.1, 0.1], abs=0.01)


def test_a_lasso_removes_one_of_two_things(tmp_path: Path) -> None:
    capture = write_two_balls(tmp_path / "capture")
    lasso = {"photo": picture_name(3), "line": line_around(RED_AT, 3), "through": True}
    recipe = {"lassos": [lasso], "cut": "scene", "fill": "none", "preset": "draft"}
    report = run(capture, tmp_path / "out", recipe)
    assert report["edits"]["lassos"] == json.loads(json.dumps([lasso]))
    mesh = trimesh.load(tmp_path / "out" / "mesh.ply", process=False)  # in the capture's frame
    xyz, _ = trimesh.sample.sample_surface(mesh, 20_000, seed=0)
    on = [np.linalg.norm(xyz - centre, axis=1) < 1.2 * RADIUS_M for centre in (RED_AT, BLUE_AT)]
    red, blue = ((each & (xyz[:, 2] > 0.03)).sum() for each in on)
    assert blue > 500
    assert red < 0.05 * blue

    with pytest.raises(BadInput, match=r"lassos.0.photo: there is no photo 'IMG_1.jpg' in this capture \(open3d\)"):
        run(capture, tmp_path / "none", {"lassos": [{**lasso, "photo": "IMG_1.jpg"}], "preset": "draft"})
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("recipe", "said"),
    [
        ({"crop": {"centre": [9, 9, 9], "size": [1, 1, 1]}, "preset": "draft"}, "the edits leave 0 of"),
        ({"crop": {"centre": [0, 0, 0], "size": [1, -1, 1]}}, "inside out"),
        ({"preset": "nonesuch"}, "nonesuch"),
    ],
)
def test_bad_edits_end_in_a_sentence_and_write_nothing(scan: Path, tmp_path: Path, recipe: Any, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        run(scan, tmp_path / "out", recipe)
    assert not (tmp_path / "out").exists()


def test_edits_are_of_one_capture(scan: Path, tmp_path: Path) -> None:
    other = scan.with_name("other.xyz")
    other.write_bytes(scan.read_bytes())
    with pytest.raises(BadInput, match="--edits are of one capture"):
        run(scan, tmp_path / "out", RECIPE, str(other))


def test_a_missing_recipe_is_named(scan: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        app, ["run", str(scan), "-o", str(tmp_path / "out"), "--edits", str(tmp_path / "no.json")]
    )
    assert isinstance(done.exception, BadInput)
    assert "no.json cannot be read" in str(done.exception)
