"""Published networks on the yardstick's clouds: GPU operations on the CPU, a peer's process, records and tables."""

from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path

import pytest
import torch

from tests.bench import __main__ as benches
from tests.bench.peers import peer_fields, peer_ops
from tests.bench.peers.peer_fields_child import GEOUDF_WEIGHTS, LOCAL_WEIGHTS, with_weights
from tests.bench.shapes import Row
from tests.support import surfaces

DISK = Row("disk", partial(surfaces.disk), points=300, resolution=24)
DENSE = Row("disk", partial(surfaces.disk), points=48_000, resolution=24)
# A repository as GeoUDF's is laid out, whose field is the distance to the nearest point's plane z = 0.
MODEL = """
from turtle import forward
import pointnet2_ops.pointnet2_utils as utils
import pytorch3d.ops
import torch

class PUGeo(torch.nn.Module):
    def __init__(self, knn):
        super().__init__()
        self.scale = torch.nn.Parameter(torch.zeros(1))
        cloud = torch.rand(1, 30, 3).cuda()
        assert utils.gather_operation(cloud.transpose(1, 2), utils.furthest_point_sample(cloud, 4)).shape == (1, 3, 4)
    def forward(self, points):
        return {"xyz": self.scale * points.transpose(1, 2)}

class UDF(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.scale = torch.nn.Parameter(torch.zeros(1))
    def forward(self, dense, queries):
        queries = queries.transpose(1, 2)
        _, _, near = pytorch3d.ops.knn_points(queries, dense["xyz"], K=1, return_nn=True)
        up = queries[..., 2] - near[:, :, 0, 2]
        return self.scale * up.abs(), torch.stack([0 * up, 0 * up, torch.sign(up)], dim=-1)
"""
PROGRAM = """
import argparse, trimesh
from model import UDF
if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    for name in ("--res", "--input", "--output"):
        parser.add_argument(name)
    asked = parser.parse_args()
    assert len(trimesh.load(asked.input).vertices) == 300 and UDF().cuda().state_dict()
    mesh = trimesh.creation.box(extents=(1, 1, 0.001 * int(asked.res)))
    mesh.remove_duplicate_faces(); mesh.remove_degenerate_faces()
    mesh.export(asked.output)
"""


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with code and weights, named by GEOUDF_FOLDER; records go to a file of the test."""
    folder = tmp_path / "geoudf"
    weights = folder / GEOUDF_WEIGHTS
    weights.mkdir(parents=True)
    (folder / "model.py").write_text(MODEL)
    (folder / "eval_rec.py").write_text(PROGRAM)
    for name in ("pu_model_best.t7", "udf_model_best.t7"):
        torch.save({"module.scale": torch.ones(1)}, weights / name)
    monkeypatch.setenv("GEOUDF_FOLDER", str(folder))
    monkeypatch.delenv("LOSF_FOLDER", raising=False)
    monkeypatch.delenv("PEERS_PYTHON", raising=False)
    monkeypatch.setattr(peer_fields, "STORED", tmp_path / "records.json")
    monkeypatch.setattr(peer_fields, "ROWS", (DISK,))
    monkeypatch.setattr(peer_fields, "OBJECTS", (DISK, DENSE))
    return folder


def run(tmp_path: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """The lines of the table."""
    peer_fields.main(["--cells", "24", "--state", str(tmp_path / "state"), *arguments])
    lines = capsys.readouterr().out.splitlines()
    assert len({line.count("|") for line in lines}) == 1, "every line has as many cells as the head"
    return lines


# GPU operations


def test_neighbours_are_the_nearest_and_have_gradients() -> None:
    rng = torch.Generator().manual_seed(0)
    points, queries = torch.rand(2, 40, 3, generator=rng), torch.rand(2, 7, 3, generator=rng).requires_grad_()
    squared, index, near = peer_ops.knn_points(queries, points, K=5, return_nn=True, return_sorted=False)
    brute = torch.cdist(queries, points).square().topk(5, largest=False)
    assert torch.equal(index, brute.indices)
    assert torch.allclose(squared, brute.values, atol=1e-6)
    assert near is not None
    assert torch.equal(near, peer_ops.knn_gather(points, index))
    (slope,) = torch.autograd.grad(squared.sum(), queries)
    assert torch.allclose(slope, 2 * (queries[:, :, None] - near).sum(dim=2), atol=1e-5)


def test_more_neighbours_than_points_are_refused() -> None:
    with pytest.raises(ValueError, match="3 points have no 4 neighbours"):
        peer_ops.knn_points(torch.rand(1, 2, 3), torch.rand(1, 3, 3), K=4)


def test_furthest_points_spread_over_a_line() -> None:
    line = torch.stack([torch.arange(9.0), torch.zeros(9), torch.zeros(9)], dim=1)[None]
    chosen = peer_ops.furthest_point_sample(line, 5)
    assert chosen[0, :3].tolist() == [0, 8, 4]
    assert sorted(chosen[0].tolist()) == [0, 2, 4, 6, 8]
    assert peer_ops.gather_operation(line.transpose(1, 2), chosen)[0, 0].tolist() == chosen[0].float().tolist()


def test_padding_at_the_origin_is_chosen_first_or_never() -> None:
    cloud = torch.tensor([[[1.0, 0, 0], [0, 0, 0], [0.9, 0, 0], [0.8, 0, 0]]])
    assert peer_ops.furthest_point_sample(cloud, 3)[0].tolist() == [0, 3, 2]
    assert peer_ops.furthest_point_sample(cloud.roll(-1, dims=1), 2)[0].tolist() == [0, 3]


def test_weights_of_several_gpus_fit_a_network_on_one(tmp_path: Path) -> None:
    layer = torch.nn.Linear(2, 3)
    torch.save({f"module.{name}": values for name, values in layer.state_dict().items()}, tmp_path / "w.t7")
    read = with_weights(torch.nn.Linear(2, 3), tmp_path / "w.t7")
    assert torch.equal(read.state_dict()["weight"], layer.weight)
    assert not read.training


# Cells


@pytest.mark.slow
def test_field_and_program_of_a_peer_are_measured_and_stay_measured(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run(tmp_path, capsys, "--picture", str(tmp_path / "picture.png"))
    field = next(line for line in first if "GeoUDF | the product's" in line).split("|")
    assert float(field[5]) < 0.02, "the disk itself"
    assert int(field[8]) == 1
    program = next(line for line in first if "GeoUDF | its own" in line).split("|")
    assert float(program[5]) > float(field[5]), "a box is not a disk"
    assert (tmp_path / "picture.png").stat().st_size > 1_000
    assert any("no LOSF_FOLDER" in line for line in first)
    assert any("LoSF-UDF" in line and "train-total-uniform.ckpt" in line for line in first)
    monkeypatch.delenv("GEOUDF_FOLDER")
    assert run(tmp_path, capsys) == first, "what is recorded needs no clone"
    records = json.loads((tmp_path / "records.json").read_text())["records"]
    assert {record["method"] for record in records} == {"geoudf", "geoudf-field"}
    assert len({record["version"] for record in records}) == 1


@pytest.mark.slow
def test_weights_that_do_not_fit_are_one_sentence_in_the_table(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.save({"other": torch.ones(1)}, repository / GEOUDF_WEIGHTS / "udf_model_best.t7")
    lines = run(tmp_path, capsys, "--peers", "geoudf-field")
    assert any("GeoUDF | the product's | 24 |" in line and "other" in line for line in lines)


def test_what_a_clone_lacks_and_what_does_not_fit_in_memory_is_named(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (repository / GEOUDF_WEIGHTS / "pu_model_best.t7").unlink()
    monkeypatch.setenv("LOSF_FOLDER", str(repository))
    monkeypatch.setattr(peer_fields, "ROWS", (DISK, DENSE))
    lines = run(tmp_path, capsys, "--table")
    assert sum("GEOUDF_FOLDER lacks" in line and "pu_model_best.t7" in line for line in lines) == 2
    assert sum("all pairs of points take 28 GB" in line for line in lines) == 2
    assert any(f"LOSF_FOLDER lacks {LOCAL_WEIGHTS}" in line for line in lines)


def test_a_process_that_takes_too_long_is_one_sentence() -> None:
    assert peer_fields.run_child("http.server", ["0"], timeout_s=0.2) == "not done after 0 s"


def test_a_process_that_is_killed_names_the_signal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho a warning >&2\nkill -SEGV $$\n")
    program.chmod(0o755)
    monkeypatch.setenv("PEERS_PYTHON", str(program))
    assert peer_fields.run_child("any", []) == "killed by SIGSEGV"


def test_the_bench_is_listed() -> None:
    assert "peer-fields" in benches.ON_DEMAND


@pytest.mark.skipif("LOSF_FOLDER" not in os.environ, reason="LOSF_FOLDER names no clone")
def test_the_published_local_shape_network_finds_a_disk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = Row("disk", partial(surfaces.disk), points=3_000, resolution=24)
    monkeypatch.setattr(peer_fields, "STORED", tmp_path / "records.json")
    monkeypatch.setattr(peer_fields, "ROWS", (row,))
    monkeypatch.setattr(peer_fields, "OBJECTS", (row,))
    lines = run(tmp_path, capsys, "--peers", "local-shape")
    assert float(next(line for line in lines if "local-shape" in line).split("|")[5]) < 0.02
