"""The bundles of a capture that is meshed by tiles: a preview, then levels of detail of the whole and all tiles."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.progress import Progress
from capture2vr.edge.tiles.folder import tiles_folder
from capture2vr.storage.bundle import Bundle, content_name, sha256_hex
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.memory import MemoryStore
from tests.edge.tiles.hall import hall

pytestmark = pytest.mark.usefixtures("small_pictures")
PRESET = load_preset("scene-tiles")
ORIGIN = np.array([691_607.0, 5_334_760.0, 520.0])


def capture() -> Capture:
    xyz = hall()
    rgb = np.clip(60 + xyz, 0, 255).astype(np.uint8)
    cloud = Cloud(xyz, rgb, origin=ORIGIN, crs="EPSG:25832")
    return Capture("points", "las", cloud, scale_confidence="metric", up=np.array([0.0, 1, 0]))


@pytest.fixture(scope="module")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Bundle], MemoryStore]:
    """What is yielded, published at once as a worker does."""
    store, made = MemoryStore(), []
    resources = JobResources(checkpoint=tmp_path_factory.mktemp("job") / "1.checkpoint")
    for step in reconstruct(capture(), PRESET, resources=resources):
        if isinstance(step, Bundle):
            publish(step, store, key="hall", job="job")
            made.append(step)
    return made, store


@pytest.mark.slow
def test_a_preview_comes_before_the_tiles(bundles: tuple[list[Bundle], MemoryStore]) -> None:
    preview, refined = bundles[0]
    assert (preview.state, preview.last) == ("preview", False)
    assert (refined.state, refined.last) == ("refined", True)
    assert "tileset" not in preview.manifest
    assert {"lod0.glb", "lod2.glb", "preview.png", "tileset.json"} <= set(refined.files)


@pytest.mark.slow
def test_the_manifest_counts_tiles(bundles: tuple[list[Bundle], MemoryStore]) -> None:
    refined = bundles[0][1]
    entry = refined.manifest["tileset"]
    assert 0.98 * len(hall()) < refined.manifest["points"] <= len(hall())  # strays are removed
    assert entry["file"] == "tileset.json"
    assert entry["tiles"] >= 1
    assert entry["triangles"] > refined.manifest["lods"][0]["triangles"] / 2


@pytest.mark.slow
def test_every_content_of_the_tileset_is_stored_beside_it(bundles: tuple[list[Bundle], MemoryStore]) -> None:
    (_, refined), store = bundles
    document = refined.files["tileset.json"]
    root = json.loads(document)["root"]
    stored = {head.name for head in store.list("assets/hall/")}
    assert f"assets/hall/{content_name('tileset.json', sha256_hex(document))}" in stored
    contents = [tile["content"]["uri"] for tile in _tiles(root) if "content" in tile]
    assert contents
    assert {f"assets/hall/{uri}" for uri in contents} <= stored


@pytest.mark.slow
def test_tiles_and_levels_of_detail_are_in_one_frame(bundles: tuple[list[Bundle], MemoryStore]) -> None:
    refined = bundles[0][1]
    x, z, y, *half = json.loads(refined.files["tileset.json"])["root"]["boundingVolume"]["box"]
    low, high = np.array(refined.manifest["bounds_m"])
    assert np.array([x, y, -z]) == pytest.approx((low + high) / 2, abs=0.3)
    assert np.array([half[0], half[8], half[4]]) == pytest.approx((high - low) / 2, abs=0.3)


@pytest.mark.slow
def test_the_tiles_of_a_survey_stand_in_their_place_on_earth(bundles: tuple[list[Bundle], MemoryStore]) -> None:
    manifest = bundles[0][1].manifest
    assert (manifest["capture_crs"], manifest["capture_offset"]) == ("EPSG:25832", ORIGIN.tolist())
    placed = np.array(json.loads(bundles[0][1].files["tileset.json"])["root"]["transform"]).reshape(4, 4).T
    asset = np.array(manifest["capture_to_asset"]).reshape(4, 4) @ [0, 0, 0, 1]
    # Where PROJ has the origin of UTM's zone 32 that the capture was moved by.
    truth = [4177973.9438, 855756.6098, 4727459.3257]
    np.testing.assert_allclose((placed @ [asset[0], -asset[2], asset[1], 1])[:3], truth, atol=0.01)


@pytest.mark.slow
def test_a_tile_that_fails_leaves_the_preview(tmp_path: Path) -> None:
    checkpoint = tmp_path / "1.checkpoint"
    done: list[Bundle] = []

    def spoil(progress: Progress) -> None:
        if progress.stage == "EXTRACTING" and done:
            for path in (tiles_folder(checkpoint) / "points").glob("*.npz"):
                path.write_bytes(b"a disk error")

    steps = reconstruct(capture(), PRESET, resources=JobResources(checkpoint=checkpoint), watch=spoil)
    with pytest.raises(EdgeError, match=r"tile \d+-\d+-\d+ of the scene failed 3 times"):
        done.extend(step for step in steps if isinstance(step, Bundle))
    assert [bundle.state for bundle in done] == ["preview"]


def _tiles(tile: dict[str, object]) -> list[dict[str, object]]:
    below = tile.get("children", [])
    assert isinstance(below, list)
    return [tile, *(each for child in below for each in _tiles(child))]
