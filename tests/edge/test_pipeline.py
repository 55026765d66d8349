"""The whole method on closed-form surfaces: it stands at the other end, in the right frame, and can be stopped."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh

from services.edge.capture.nouns import Capture, Cloud
from services.edge.errors import Cancelled, EdgeError
from services.edge.pipeline import STAGE_STARTS, reconstruct
from services.edge.preset import Preset, load_preset
from services.edge.progress import Progress
from services.storage.bundle import Bundle


def _bowl(points: int = 5000, *, radius: float = 1.0, centre: float = 0.0) -> Capture:
    direction = np.random.default_rng(0).normal(size=(points, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = -np.abs(direction[:, 2])
    rgb = ((direction * 0.5 + 0.5) * 255).astype(np.uint8)
    up = np.array([0.0, 0.0, 1.0])
    return Capture("points", "ply", Cloud(direction * radius + centre, rgb), scale_confidence="metric", up=up)


@pytest.fixture(scope="module")
def steps() -> list[Progress | Bundle]:
    """All that one reconstruction says."""
    inside: list[Progress | Bundle] = []
    for step in reconstruct(_bowl(), load_preset("draft"), label="Bowl", watch=inside.append):
        inside.append(step)
    return inside


def test_the_fraction_never_goes_back(steps: list[Progress | Bundle]) -> None:
    fractions = [step.fraction for step in steps if isinstance(step, Progress)]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] < fractions[-1] <= 1


def test_stages_come_in_order_and_say_what_they_do(steps: list[Progress | Bundle]) -> None:
    stages = list(dict.fromkeys(step.stage for step in steps if isinstance(step, Progress)))
    assert stages == [stage for stage in STAGE_STARTS if stage in stages]
    assert {"POINT_CLOUD", "FITTING", "EXTRACTING", "PACKING"} <= set(stages)


def test_the_bundle_holds_an_open_bowl_standing_upright(steps: list[Progress | Bundle]) -> None:
    (bundle,) = [step for step in steps if isinstance(step, Bundle)]
    assert bundle.state == "preview"
    manifest = bundle.manifest
    assert manifest["label"] == "Bowl"
    assert manifest["quality"]["components"] == 1
    assert manifest["quality"]["boundary_loops"] == 1
    assert manifest["quality"]["non_manifold_edges"] == 0
    assert manifest["size_m"] == pytest.approx([2, 1, 2], abs=0.08)
    glb = trimesh.load(io.BytesIO(bundle.files["lod0.glb"]), file_type="glb", force="mesh")
    assert len(glb.faces) == manifest["lods"][0]["triangles"]
    # The bowl's bottom touches the floor, its rim is up.
    assert np.linalg.norm(glb.vertices - [0, 1, 0], axis=1) == pytest.approx(1, abs=0.05)


def test_a_georeferenced_cloud_keeps_its_place_and_precision() -> None:
    capture = _bowl(radius=2.0, centre=1e6)
    *_, bundle = reconstruct(capture, load_preset("draft"))
    mesh = trimesh.load(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply")
    assert np.linalg.norm(mesh.vertices - 1e6, axis=1) == pytest.approx(2, abs=0.2)


def test_the_resolution_of_a_preset_is_obeyed() -> None:
    *_, coarse = reconstruct(_bowl(), Preset("coarse", resolution=32))
    *_, fine = reconstruct(_bowl(), Preset("fine", resolution=96))
    assert coarse.manifest["quality"]["resolution"] == 32
    assert fine.manifest["quality"]["triangles"] > 4 * coarse.manifest["quality"]["triangles"]


@pytest.mark.parametrize("stage", ["POINT_CLOUD", "EXTRACTING", "PACKING"])
def test_it_stops_where_it_is_told_to(stage: str) -> None:
    def stop(progress: Progress) -> None:
        if progress.stage == stage:
            raise Cancelled

    with pytest.raises(Cancelled):
        list(reconstruct(_bowl(), load_preset("draft"), watch=stop))


def test_the_same_capture_gives_the_same_bytes() -> None:
    first, second = ([*reconstruct(_bowl(), load_preset("draft"))][-1] for _ in range(2))
    assert first.files["mesh.ply"] == second.files["mesh.ply"]
    assert first.files["lod2.glb"] == second.files["lod2.glb"]


def test_too_few_points_are_refused_with_a_name() -> None:
    with pytest.raises(EdgeError) as told:
        list(reconstruct(_bowl(12), load_preset("draft")))
    assert told.value.code == "CAPTURE_TOO_FEW_POINTS"
    assert "12" in told.value.message
