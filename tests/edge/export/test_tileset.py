"""tileset.json: what 3D Tiles 1.1 asks for, and what a viewer relies on."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.export.tileset import TilesetNode, tileset_json
from capture2vr.storage.bundle import hash_in_name, sha256_hex
from tests.referees.glb_reader import Glb
from tests.support.tilesets import hill_bundle


def _tiles(tile: dict[str, Any]) -> list[dict[str, Any]]:
    return [tile, *(below for child in tile.get("children", ()) for below in _tiles(child))]


def _low_high(tile: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """A box without turned axes: its corners, Z up."""
    box = np.array(tile["boundingVolume"]["box"])
    half = np.diag(box[3:].reshape(3, 3))
    return box[:3] - half, box[:3] + half


def test_every_content_is_a_file_of_the_bundle_in_its_box() -> None:
    bundle, root = hill_bundle(levels=3)
    tiles = _tiles(json.loads(bundle.files["tileset.json"])["root"])

    assert len(tiles) == 1 + 4 + 16 == len(list(root))
    for tile in tiles:
        glb = bundle.files[tile["content"]["uri"]]
        assert hash_in_name(tile["content"]["uri"]) == sha256_hex(glb)
        x, y, z = Glb.of(glb).positions.T  # Y up
        turned = np.stack([x, -z, y], 1)
        low, high = _low_high(tile)
        assert np.all(turned >= low - 1e-6)
        assert np.all(turned <= high + 1e-6)


def test_boxes_and_errors_shrink_towards_the_leaves() -> None:
    bundle, _ = hill_bundle(levels=3)
    document = json.loads(bundle.files["tileset.json"])

    assert document["asset"]["version"] == "1.1"
    assert document["root"]["refine"] == "REPLACE"
    assert document["geometricError"] > document["root"]["geometricError"]
    for tile in _tiles(document["root"]):
        low, high = _low_high(tile)
        assert tile["geometricError"] == 0 or tile["children"]
        for child in tile.get("children", ()):
            child_low, child_high = _low_high(child)
            assert np.all(child_low >= low - 1e-6)
            assert np.all(child_high <= high + 1e-6)
            assert child["geometricError"] <= tile["geometricError"]


def test_a_flat_tile_has_a_box_with_some_height() -> None:
    flat = TilesetNode("floor.glb", "0" * 64, np.array([0.0, 1.0, 0.0]), np.array([2.0, 1.0, 4.0]), 0.0)

    box = json.loads(tileset_json(flat))["root"]["boundingVolume"]["box"]

    assert box[:3] == [1, -2, 1]
    assert (box[3], box[7]) == (1, 2)
    assert box[11] > 0


def test_a_node_without_content_names_none() -> None:
    leaf = TilesetNode("tile.glb", "a" * 64, np.zeros(3), np.ones(3), 0.0)
    root = TilesetNode("", "", np.zeros(3), np.ones(3), 0.5, (leaf,))

    document = json.loads(tileset_json(root))

    assert "content" not in document["root"]
    assert document["root"]["children"][0]["content"] == {"uri": f"tile.{'a' * 64}.glb"}


def test_a_place_on_earth_is_the_roots_transform() -> None:
    """Column by column; as a viewer does it, a content is turned so that Z is up, and then placed."""
    tile = TilesetNode("tile.glb", "a" * 64, np.zeros(3), np.ones(3), 0.0)
    assert "transform" not in json.loads(tileset_json(tile))["root"]
    to_earth = np.random.default_rng(0).normal(0, 1e6, (4, 4))
    to_earth[3] = 0, 0, 0, 1

    root = json.loads(tileset_json(tile, to_earth))["root"]

    placed = np.array(root["transform"]).reshape(4, 4).T
    np.testing.assert_allclose(placed @ [0.1, -0.3, 0.2, 1], to_earth @ [0.1, 0.2, 0.3, 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"high_m": np.array([1.0, 1.0, 1.5])}, "its box leaves that of root.glb"),
        ({"error_m": 0.6}, "its error of 0.6 m exceeds the 0.5 m of its parent"),
    ],
)
def test_a_tile_that_no_viewer_would_draw_is_refused(changes: dict[str, Any], reason: str) -> None:
    leaf = TilesetNode("tile.glb", "a" * 64, np.zeros(3), np.ones(3), 0.0)
    root = TilesetNode("root.glb", "b" * 64, np.zeros(3), np.ones(3), 0.5, (replace(leaf, **changes),))

    with pytest.raises(ValueError, match=f"tile.glb: {reason}"):
        tileset_json(root)
