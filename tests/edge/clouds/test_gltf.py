"""glTF files as scanning apps, gltfpack and glTF-Transform write them: colours and sizes are those that were meant."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.errors import CaptureError
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.srgb import to_linear, to_srgb
from tests.support import captures
from tests.support.gltf_files import cloud_of

BALL = trimesh.creation.icosphere(subdivisions=3)
VERTICES, FACES = np.asarray(BALL.vertices, np.float32), np.asarray(BALL.faces)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
TWO = np.array([[0, 1, 2], [0, 2, 3]])
UV = SQUARE[:, :2].copy()  # x is u, and y is v, which runs down in the picture
RAMP = np.stack([*np.meshgrid(np.arange(0, 256, 2), np.arange(0, 256, 2)), np.full((128, 128), 77)], -1)
"""(128,128,3): red is the column, green the row, 0 to 254."""

PAINTED: dict[str, object] = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
Place = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
BYTE = st.integers(0, 255)
COLOUR = st.tuples(BYTE, BYTE, BYTE)


def colours_of(data: bytes) -> np.ndarray:
    rgb = cloud_of(data).rgb
    assert rgb is not None
    return rgb


def parts_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The tree of a GLB, and its binary chunk."""
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def stored(colour: tuple[int, int, int], kind: str, width: int) -> np.ndarray:
    """(V,width) linear light of an sRGB colour, opaque, for every vertex of the ball."""
    light = np.append(to_linear(np.array(colour, np.uint8)), 1.0)[:width]
    return np.tile(light if kind == "f4" else np.rint(light * np.iinfo(kind).max), (len(VERTICES), 1)).astype(kind)


@settings(max_examples=8, deadline=None)
@given(colour=COLOUR, kind=st.sampled_from(["f4", "u2", "u1"]), width=st.sampled_from([3, 4]), plain=st.booleans())
def test_vertex_colours_are_linear_light(colour: tuple[int, int, int], kind: str, width: int, plain: bool) -> None:
    """With a material and without; eight bits of linear light are too few for dark colours."""
    rows = stored(colour, kind, width)
    data = captures.glb_bytes(
        {"POSITION": VERTICES, "COLOR_0": rows}, FACES, normalised=("COLOR_0",), material=None if plain else {}
    )
    expected = to_srgb(rows[:1, :3] / 255) if kind == "u1" else np.array([colour])
    assert (colours_of(data) == expected).all()


def test_a_vertex_coloured_download_reads_back() -> None:
    rgb = np.tile(np.array([200, 128, 64], np.uint8), (len(VERTICES), 1))
    assert (colours_of(to_glb(Mesh(BALL.vertices, FACES, rgb), "float")) == rgb[0]).all()


@settings(max_examples=8, deadline=None)
@given(vertex=COLOUR, factor=COLOUR, texel=COLOUR)
def test_texture_factor_and_vertex_colours_are_multiplied_as_light(
    vertex: tuple[int, int, int], factor: tuple[int, int, int], texel: tuple[int, int, int]
) -> None:
    linear = np.array(factor) / 255
    material: dict[str, object] = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [*linear, 1]}
    }
    attributes = {
        "POSITION": VERTICES,
        "TEXCOORD_0": np.zeros((len(VERTICES), 2), np.float32),
        "COLOR_0": stored(vertex, "f4", 4),
    }
    picture = np.full((4, 4, 3), texel, np.uint8)
    found = colours_of(captures.glb_bytes(attributes, FACES, material=material, picture=picture))
    light = to_linear(np.array(vertex, np.uint8)) * to_linear(np.array(texel, np.uint8)) * linear
    assert np.abs(found.astype(int) - to_srgb(light)).max() <= 1


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2"])
def test_normalised_positions_are_fractions(kind: str) -> None:
    """A ball of 1 m radius, as the node's transform makes it again of whole numbers."""
    top = np.iinfo(kind).max
    if kind[0] == "i":
        rows, node = np.rint(VERTICES * top), {"scale": [1, 1, 1]}
    else:
        rows, node = np.rint((VERTICES + 1) / 2 * top), {"scale": [2, 2, 2], "translation": [-1, -1, -1]}
    data = captures.glb_bytes(
        {"POSITION": rows.astype(kind)}, FACES, normalised=("POSITION",), node=node, required=("KHR_mesh_quantization",)
    )
    lengths = np.linalg.norm(cloud_of(data).xyz, axis=1)
    assert lengths.min() > 0.97
    assert lengths.max() < 1.01


def test_the_least_signed_integer_is_minus_one() -> None:
    corners = np.where(SQUARE > 0, 127, -128).astype(np.int8)
    data = captures.glb_bytes({"POSITION": corners}, TWO, normalised=("POSITION",))
    assert cloud_of(data).xyz.min() == pytest.approx(-1, abs=1e-9)


def test_whole_numbers_that_are_not_normalised_stay() -> None:
    data = captures.glb_bytes({"POSITION": (SQUARE * 100).astype(np.uint16)}, TWO, node={"scale": [0.01] * 3})
    assert np.ptp(cloud_of(data).xyz, axis=0) == pytest.approx([1, 1, 0], abs=0.01)


@pytest.mark.parametrize("stored", [True, False])
def test_sparse_positions_replace_those_of_the_buffer(stored: bool, tmp_path: Path) -> None:
    """A corner that is moved, or two that are not zeros."""
    tree, chunk = parts_of(captures.glb_bytes({"POSITION": SQUARE}, TWO))
    rows, places = (SQUARE[[2]] * 3, [2]) if stored else (SQUARE[[1, 2]] * 3, [1, 2])
    content = np.array(places, "<u2").tobytes().ljust(4, b"\0") + rows.astype("<f4").tobytes()
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(chunk), "byteLength": len(content)})
    view = {"bufferView": len(tree["bufferViews"]) - 1}
    sparse = {"count": len(places), "indices": view | {"componentType": 5123}, "values": view | {"byteOffset": 4}}
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    accessor["sparse"] = sparse
    if not stored:
        del accessor["bufferView"]
    tree["buffers"][0] = {"uri": "scan.bin", "byteLength": len(chunk + content)}
    (tmp_path / "scan.gltf").write_text(json.dumps(tree))
    (tmp_path / "scan.bin").write_bytes(chunk + content)
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert cloud.xyz.max(axis=0) == pytest.approx([3, 3, 0], abs=0.1)


def assert_ramp(data: bytes, place: Place) -> None:
    """Assert that the square's points have the colours of the ramp at the places that `place` has of their u and v."""
    cloud = cloud_of(data)
    assert cloud.rgb is not None
    u, v = place(cloud.xyz[:, 0], cloud.xyz[:, 1])
    inner = (np.minimum(u, v) > 0.01) & (np.maximum(u, v) < 0.99)
    assert inner.mean() > 0.9
    expected = 254 * np.stack([u, v], axis=1)
    assert np.abs(cloud.rgb[inner, :2] - expected[inner]).max() < 4


@pytest.mark.parametrize("kind", ["u1", "u2"])
def test_normalised_texture_coordinates_are_fractions(kind: str) -> None:
    uv = (UV * np.iinfo(kind).max).astype(kind)
    data = captures.glb_bytes(
        {"POSITION": SQUARE, "TEXCOORD_0": uv}, TWO, normalised=("TEXCOORD_0",), material=PAINTED, picture=RAMP
    )
    assert_ramp(data, lambda u, v: (u, v))


TRANSFORMS: dict[str, tuple[dict[str, object], Place]] = {
    "the example of the extension: the lower left quarter, turned": (
        {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]},
        lambda u, v: (v / 2, 1 - u / 2),
    ),
    "the other example: v runs up": ({"offset": [0, 1], "scale": [1, -1]}, lambda u, v: (u, 1 - v)),
    "scale before rotation": (
        {"offset": [0.5, 0.25], "rotation": -np.pi / 2, "scale": [0.5, 0.25]},
        lambda u, v: (0.5 - v / 4, 0.25 + u / 2),
    ),
}


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.parametrize("kind", ["f4", "u2"])
def test_texture_transforms(name: str, kind: str) -> None:
    transform, place = TRANSFORMS[name]
    material: dict[str, object] = {
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": transform}},
        }
    }
    uv = UV if kind == "f4" else (UV * 65535).astype(np.uint16)
    data = captures.glb_bytes(
        {"POSITION": SQUARE, "TEXCOORD_0": uv},
        TWO,
        normalised=("TEXCOORD_0",) if kind == "u2" else (),
        material=material,
        picture=RAMP,
        required=("KHR_texture_transform",),
    )
    assert_ramp(data, place)


@pytest.mark.parametrize(
    "texture", [{"texCoord": 1}, {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}]
)
def test_the_texture_names_its_set_of_coordinates(texture: dict[str, object]) -> None:
    material: dict[str, object] = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **texture}}}
    attributes = {"POSITION": SQUARE, "TEXCOORD_0": np.zeros_like(UV), "TEXCOORD_1": UV}
    assert_ramp(captures.glb_bytes(attributes, TWO, material=material, picture=RAMP), lambda u, v: (u, v))


def test_the_diffuse_texture_of_an_older_material_is_its_colour() -> None:
    gloss = {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}}
    attributes = {"POSITION": SQUARE, "TEXCOORD_0": UV}
    data = captures.glb_bytes(attributes, TWO, material={"extensions": gloss}, picture=RAMP, required=tuple(gloss))
    assert_ramp(data, lambda u, v: (u, v))


def test_a_black_material_that_shines_has_the_colour_that_it_shines_in() -> None:
    black: dict[str, object] = {"baseColorFactor": [0, 0, 0, 1]}
    shines: dict[str, object] = {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}}
    attributes = {"POSITION": SQUARE, "TEXCOORD_0": UV}
    data = captures.glb_bytes(attributes, TWO, material={"pbrMetallicRoughness": black, **shines}, picture=RAMP)
    assert_ramp(data, lambda u, v: (u, v))
    lit = captures.glb_bytes(
        attributes, TWO, material={"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}, **shines}, picture=RAMP
    )
    assert (colours_of(lit) == (255, 0, 0)).all()
    alone = {"pbrMetallicRoughness": black, "emissiveFactor": [0, 1, 0]}
    assert (colours_of(captures.glb_bytes(attributes, TWO, material=alone)) == (0, 255, 0)).all()


def with_mode(data: bytes, mode: int, **changes: object) -> bytes:
    """A GLB whose primitive has another mode, and perhaps no indices."""
    tree, chunk = parts_of(data)
    primitive = tree["meshes"][0]["primitives"][0]
    primitive |= {"mode": mode}
    if "indices" in changes:
        del primitive["indices"]
    return captures.glb_of(tree, chunk)


@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
def test_points_are_a_cloud_with_their_colours(kind: str) -> None:
    colour = (200, 60, 9)
    attributes = {"POSITION": VERTICES, "COLOR_0": stored(colour, kind, 4)}
    data = captures.glb_bytes(attributes, FACES, normalised=("COLOR_0",), node={"translation": [1, 2, 3]})
    cloud = cloud_of(with_mode(data, 0, indices=None))
    np.testing.assert_allclose(cloud.xyz, VERTICES + np.array([1, 2, 3]), atol=1e-6)
    assert cloud.rgb is not None
    # Eight bits of linear light are coarse where it is dark.
    np.testing.assert_allclose(cloud.rgb, np.tile(colour, (len(VERTICES), 1)), atol=13 if kind == "u1" else 1)
    assert cloud_of(with_mode(captures.glb_bytes({"POSITION": VERTICES}, FACES), 0, indices=None)).rgb is None


@pytest.mark.parametrize("indexed", [True, False])
def test_a_fan_is_triangles(indexed: bool) -> None:
    turn = np.linspace(0, 2 * np.pi, 33)[:, None]
    rim = np.hstack([np.cos(turn), np.sin(turn), 0 * turn])
    corners = np.concatenate([[(0, 0, 0)], rim]).astype(np.float32)
    data = captures.glb_bytes({"POSITION": corners}, np.arange(len(corners))[None])
    cloud = cloud_of(with_mode(data, 6) if indexed else with_mode(data, 6, indices=None))
    radius = np.linalg.norm(cloud.xyz, axis=1)
    assert radius.max() <= 1 + 1e-6
    assert np.mean(radius < 0.5) == pytest.approx(0.25, abs=0.02), "all of the disk, evenly"


def test_a_gltf_with_its_buffer_beside_it_is_rewritten_too(tmp_path: Path) -> None:
    data = captures.glb_bytes({"POSITION": SQUARE, "COLOR_0": np.full((4, 3), 0.5, np.float32)}, TWO)
    tree, chunk = parts_of(data)
    tree["buffers"][0]["uri"] = "scan.bin"
    (tmp_path / "scan.gltf").write_text(json.dumps(tree))
    (tmp_path / "scan.bin").write_bytes(chunk)
    cloud = read_capture(tmp_path / "scan.gltf").cloud
    assert cloud is not None
    assert cloud.rgb is not None
    assert (cloud.rgb == to_srgb(np.float32(0.5))).all()


@pytest.mark.parametrize("there", [True, False])
def test_files_beside_a_gltf_may_have_names_with_spaces(there: bool, tmp_path: Path) -> None:
    """As URIs have them; a texture that is absent is named."""
    data = captures.glb_bytes({"POSITION": SQUARE, "TEXCOORD_0": UV}, TWO, material=PAINTED, picture=RAMP)
    tree, chunk = parts_of(data)
    view = tree["bufferViews"][tree["images"][0].pop("bufferView")]
    picture = chunk[view.get("byteOffset", 0) :][: view["byteLength"]]
    tree["images"][0] = {"uri": "my%20paint.png"}
    tree["buffers"][0]["uri"] = "my%20scan.bin"
    (tmp_path / "scan.gltf").write_text(json.dumps(tree))
    (tmp_path / "my scan.bin").write_bytes(chunk)
    if there:
        (tmp_path / "my paint.png").write_bytes(picture)
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert (np.ptp(capture.cloud.rgb[:, 0]) > 200) == there
    assert [("my%20paint.png" in warning) for warning in capture.warnings] == ([] if there else [True])


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("KHR_draco_mesh_compression", "without compression"),
        ("EXT_meshopt_compression", "without compression"),
        ("KHR_meshopt_compression", "without compression"),
        ("KHR_texture_basisu", "JPEG or PNG"),
        ("ACME_new_shapes", "without this extension"),
    ],
)
def test_extensions_that_are_not_read_are_refused_by_name(name: str, advice: str) -> None:
    with pytest.raises(CaptureError, match=f"scan.glb: needs {name}, which is not supported") as caught:
        cloud_of(captures.glb_bytes({"POSITION": VERTICES}, FACES, required=(name,)))
    assert caught.value.code == "CAPTURE_UNREADABLE"
    assert advice in caught.value.hints[0]


def test_extensions_that_change_the_shading_alone_are_read() -> None:
    names = ("KHR_materials_unlit", "KHR_materials_clearcoat", "KHR_lights_punctual")
    assert len(cloud_of(captures.glb_bytes({"POSITION": VERTICES}, FACES, required=names)).xyz)


def test_the_rows_that_are_read_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many primitives may use one accessor."""
    monkeypatch.setattr("capture2vr.edge.clouds.gltf.MAX_POINTS", 250)
    attributes = {"POSITION": VERTICES, "COLOR_0": np.ones((len(VERTICES), 3), np.float32)}
    with pytest.raises(CaptureError, match="has 1,284 points") as caught:
        cloud_of(with_mode(captures.glb_bytes(attributes, FACES[:1]), 4, indices=None))
    assert caught.value.code == "CAPTURE_TOO_LARGE"
