"""What an asset may cost on a device, and what it costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.asset.target import (
    NO_TARGET,
    TARGETS,
    Cost,
    measure_cost,
    require_budget,
    require_encoder,
    target_of,
)
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.glb import Packing, to_glb
from capture2vr.edge.mesh.nouns import TexturedMesh
from capture2vr.edge.texture.bake import jpeg_of
from tests.support import surfaces

WAVE = surfaces.patch(lambda u, v: [u, v, 0.1 * np.sin(9 * u)], 60, 60)
CHEAP = Cost(triangles=2_000, vertices=1_100, draw_calls=1, bytes=40_000, unpacked_bytes=60_000, texture_bytes=0)


@pytest.mark.parametrize("packing", ["float", "meshopt"])
def test_costs_are_those_of_the_file(packing: Packing) -> None:
    coloured = replace(WAVE, rgb=np.full((len(WAVE.vertices), 3), 200, np.uint8))
    glb = to_glb(coloured, packing)
    cost = measure_cost(glb)
    assert (cost.triangles, cost.draw_calls, cost.bytes) == (len(WAVE.faces), 1, len(glb))
    per_vertex = 12 + 12 + 8 if packing == "float" else 8 + 4 + 8
    assert cost.unpacked_bytes == per_vertex * cost.vertices + 2 * 3 * cost.triangles
    assert (cost.bytes < cost.unpacked_bytes) == (packing == "meshopt")


@pytest.mark.parametrize("packing", ["float", "meshopt"])
@pytest.mark.parametrize(("side", "texels"), [(64, 64 * 64 + 1365), (1, 1)])
def test_a_texture_costs_four_bytes_a_texel_and_its_mips(packing: Packing, side: int, texels: int) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (side, side, 3), dtype=np.uint8)
    asset = TexturedMesh(WAVE, np.zeros((len(WAVE.vertices), 2)), jpeg_of(noise, 88), side)
    glb = to_glb(asset, packing)
    cost = measure_cost(glb)
    assert cost.texture_bytes == 4 * texels
    assert cost.bytes == len(glb)
    per_vertex = 12 + 12 + 8 if packing == "float" else 8 + 4 + 4
    assert cost.unpacked_bytes == per_vertex * cost.vertices + 2 * 3 * cost.triangles


@pytest.mark.parametrize("name", [*TARGETS, ""])
def test_a_cheap_asset_is_within_every_target(name: str) -> None:
    require_budget(target_of(name), [CHEAP, CHEAP, CHEAP])


@pytest.mark.parametrize(
    ("level", "figure", "value", "told"),
    [
        (0, "triangles", 100_001, "LOD 0 has 100,001 triangles, the most is 100,000"),
        (2, "triangles", 5_001, "LOD 2 has 5,001 triangles, the most is 5,000"),
        (2, "bytes", 300_001, "LOD 2 has 300,001 bytes, the most is 300,000"),
        (0, "unpacked_bytes", 41 << 20, "bytes on the device"),
        (1, "texture_bytes", 40 << 20, "LOD 1 has 42,003,040 bytes on the device"),
    ],
)
def test_what_is_beyond_a_target_is_named(level: int, figure: str, value: int, told: str) -> None:
    levels = [CHEAP, CHEAP, CHEAP]
    levels[level] = replace(CHEAP, **{figure: value})
    with pytest.raises(EdgeError, match="quest3") as caught:
        require_budget(target_of("quest3"), levels)
    assert caught.value.code == "BUDGET_UNREACHABLE"
    assert told in caught.value.message
    require_budget(NO_TARGET, levels)


def test_a_target_that_there_is_not_names_those_that_there_are() -> None:
    with pytest.raises(EdgeError, match="quest9") as caught:
        target_of("quest9")
    assert caught.value.code == "TARGET_UNKNOWN"
    assert all(name in caught.value.hints[0] for name in TARGETS)


@pytest.mark.parametrize("name", TARGETS)
def test_every_target_has_an_unlit_twin(name: str) -> None:
    assert target_of(f"{name}-unlit") == replace(TARGETS[name], name=f"{name}-unlit", unlit=True)
    assert not target_of(name).unlit


@pytest.mark.parametrize("name", [name for name, target in TARGETS.items() if target.texture_px])
def test_what_has_textures_may_have_them_as_ktx2(name: str) -> None:
    assert target_of(f"{name}-ktx2") == replace(TARGETS[name], name=f"{name}-ktx2", ktx2=True)
    both = target_of(f"{name}-unlit-ktx2")
    assert both == replace(TARGETS[name], name=f"{name}-unlit-ktx2", unlit=True, ktx2=True)
    assert not target_of(name).ktx2


def test_what_has_textures_may_have_normal_maps() -> None:
    assert target_of("quest3-normals").normal_px == 1024
    assert target_of("quest3").normal_px == 0
    for name in ("archive-normals", "quest3-unlit-normals", "quest3-normals-ktx2", "-normals"):
        with pytest.raises(EdgeError, match="there is no target"):
            target_of(name)


def test_without_an_encoder_ktx2_is_refused_with_what_to_do() -> None:
    require_encoder(target_of("quest3"), has_encoder=False)
    require_encoder(target_of("quest3-unlit-ktx2"), has_encoder=True)
    with pytest.raises(EdgeError, match="EDGE_KTX2 is not set") as caught:
        require_encoder(target_of("quest3-unlit-ktx2"), has_encoder=False)
    assert caught.value.code == "KTX2_UNAVAILABLE"
    assert "npm install --prefix FOLDER ktx2-encoder@" in caught.value.hints[0]


@pytest.mark.parametrize("name", ["archive-ktx2", "archive-unlit-ktx2", "-ktx2", "web-ktx2-ktx2", "web-ktx2-unlit"])
def test_ktx2_of_nothing_is_no_target(name: str) -> None:
    with pytest.raises(EdgeError) as caught:
        target_of(name)
    assert caught.value.code == "TARGET_UNKNOWN"
    assert "-ktx2" in caught.value.hints[1]


@pytest.mark.parametrize(
    ("size", "levels", "blocks"),
    [((64, 64), 7, 256 + 64 + 16 + 4 + 1 + 1 + 1), ((64, 64), 1, 256), ((64, 16), 2, 64 + 16), ((4, 4), 3, 3)],
)
def test_ktx2_costs_a_byte_a_texel_in_whole_blocks(size: tuple[int, int], levels: int, blocks: int) -> None:
    head = b"\xabKTX 20\xbb\r\n\x1a\n" + np.array([0, 1, *size, 0, 0, 1, levels, 1], "<u4").tobytes()
    asset = TexturedMesh(WAVE, np.zeros((len(WAVE.vertices), 2)), b"", size[0], head)
    assert measure_cost(to_glb(asset)).texture_bytes == 16 * blocks
