"""What the Godot addon's tests load and compare with: the published assets, spoilt catalogues, files and streams."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshopt
import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.convert.read_glb import read_glb
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from tests.support.clients.catalogue_tree import RECORD, Tree, TreeWriter, hexadecimal, row, rows_in
from tests.support.clients.client_world import build
from tests.support.downloadable import SHEET, coloured, textured

_BELOW = "collections/default"
_SIGNED = {"index.json", "root.json"}
_BROKEN = {"cut_off": -9, "empty": 0}  # bytes that are left of the index


def facts(root: Path, project: Path) -> dict[str, Any]:
    """Publish everything below `root`, put files to import into `project`; the facts that the tests compare with."""
    told = build(root)
    _catalogues(root)
    trees = _trees(root)
    files = list(_files(project))
    imported = [{**file, "path": f"res://imported/{Path(file['path']).name}"} for file in files]
    spoilt = [{"name": name, "file": _base64(data)} for name, data in _spoilt().items()]
    broken = [*_BROKEN, "no_json", "numbers"]
    return {
        **told,
        "trees": trees,
        "files": files,
        "imported": imported,
        "spoilt": spoilt,
        "streams": list(_streams()),
        "broken": broken,
    }


def _catalogues(root: Path) -> None:
    """Copies of v2 with a root or an index that is not to be taken."""
    for name in ("altered", "unsigned", "no_json", "numbers", *_BROKEN):
        shutil.copytree(root / "v2", root / name)
    for told in _SIGNED.intersection(file.name for file in (root / "v2" / _BELOW).iterdir()):
        whole = (root / "v2" / _BELOW / told).read_bytes()
        envelope = json.loads(whole)
        signed = envelope["signed"].replace('"version"', '"version" ')  # the same JSON, and another text
        altered = {**envelope, "signed": signed}
        spoilt = {
            "altered": json.dumps(altered).encode(),
            "unsigned": json.dumps({**envelope, "signatures": []}).encode(),
            "no_json": b"<html>",
            "numbers": json.dumps({"signed": 1, "signatures": 2}).encode(),
            **{name: whole[:left] for name, left in _BROKEN.items()},
        }
        for name, data in spoilt.items():
            (root / name / _BELOW / told).write_bytes(data)
    swapped = root / "swapped"
    shutil.copytree(root / "v2", swapped)
    shutil.copytree(swapped / _BELOW, swapped / "collections" / "other")


def _trees(root: Path) -> dict[str, Any]:
    """Copies of v2 with trees that list further assets too: of each depth, newer, with something gone or changed."""
    writer = TreeWriter()
    listed = rows_in(root / "v2")
    more = [row(f"c{place:03}", labels=["filler"]) for place in range(40)]  # between bowl and cup
    told: dict[str, Any] = {"key": writer.public_key}
    for depth, count in enumerate((0, 20, 40)):
        tree = writer.write(_sorted(listed + more[:count]))
        _copy_with(root, f"tree{depth}", tree)
        keys = sorted(tree.shard_of)
        told[f"tree{depth}"] = {"keys": keys, "path": tree.path_to("cup"), "files": sorted(tree.files)}
    path = tree.path_to("cup")
    for level, name in enumerate(path):
        _copy_with(root, f"tree_without_{level}", tree).joinpath(name).unlink()
        for spoilt, data in {
            "changed": tree.files[name].replace(b'"c0', b'"b0'),
            "longer": tree.files[name] + b" ",
        }.items():
            _copy_with(root, f"tree_{spoilt}_{level}", tree).joinpath(name).write_bytes(data)
    newer = replace(writer, version=2, commit="two")
    _copy_with(root, "tree_newer", newer.write(_sorted(listed + more)))
    _copy_with(root, "tree_too_deep", writer.write(more, depth=9))
    _copy_with(root, "tree_too_large", writer.write(more, children=[["A" * 43, 2**24 + 1, 1, "a", "z"]]))
    _copy_with(root, "tree_outside", writer.write(more, children=[["../" + "A" * 40, 9, 1, "a", "z"]]))
    _flat(root, writer, listed)
    return told


def _flat(root: Path, writer: TreeWriter, listed: list[dict[str, Any]]) -> None:
    """A store from before there were trees, and one that keeps only a stub of its index."""
    tree = writer.write(_sorted(listed))
    shards = [
        {**dict(zip(RECORD, child, strict=True)), "sha256": hexadecimal(child[0])}
        for child in json.loads(json.loads(tree.files.pop(tree.name("root.json")))["signed"])["children"]
    ]
    index = {"schema": 1, "collection": "default", "version": 1}
    for name, signed in {"flat": {**index, "shards": shards}, "stub": {**index, "schema": 2}}.items():
        _copy_with(root, name, tree).joinpath(_BELOW, "index.json").write_bytes(writer.envelope(signed))


def _sorted(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda each: str(each["key"]))


def _copy_with(root: Path, name: str, tree: Tree) -> Path:
    shutil.copytree(root / "v2", root / name)
    tree.write_to(root / name)
    return root / name


def _files(project: Path) -> Iterator[dict[str, Any]]:
    """Levels of detail in both packings, below `project`, with what the product's own reader has of each."""
    folder = project / "imported"
    folder.mkdir()
    assets: dict[str, Mesh | TexturedMesh] = {"plain": SHEET, "coloured": coloured(), "textured": textured()}
    for name, asset in assets.items():
        for packing in ("float", "meshopt"):
            path = folder / f"{name}_{packing}.glb"
            path.write_bytes(to_glb(asset, packing))  # type: ignore[arg-type]
            yield {"path": str(path), **_read(path.read_bytes())}


def _read(data: bytes) -> dict[str, Any]:
    level = read_glb(data).mesh
    mesh = level.mesh if isinstance(level, TexturedMesh) else level
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    rgb = None if mesh.rgb is None else mesh.rgb.mean(axis=0).tolist()
    textured = isinstance(level, TexturedMesh)
    return {"triangles": len(mesh.faces), "low": low.tolist(), "high": high.tolist(), "rgb": rgb, "textured": textured}


def _spoilt() -> dict[str, bytes]:
    """Files of which no mesh can be made."""
    whole = to_glb(SHEET, "meshopt")
    start = whole.index(b"BIN\0") + 4
    endless = re.sub(rb'(?<="count":)\d+', lambda count: b"9" * len(count[0]), whole)
    return {
        "empty": b"",
        "text": b"not a mesh",
        "half": whole[: len(whole) // 2],
        "no stream": whole[:start] + bytes(len(whole) - start),
        "more rows than the stream has": endless,
    }


def _streams() -> Iterator[dict[str, Any]]:
    """Buffer views of all modes and filters, with what meshoptimizer itself decodes of them."""
    random = np.random.default_rng(7)
    for count in (1, 15, 16, 17, 255, 256, 257, 3000):
        for stride in (4, 8, 12, 16, 48):
            smooth = np.cumsum(random.integers(-3, 4, (count, stride)), axis=0).astype(np.uint8)
            noise = random.integers(0, 256, (count, stride)).astype(np.uint8)
            mixed = np.where(random.random((count, stride)) < 0.1, noise, smooth)
            for name, rows in (("smooth", smooth), ("noise", noise), ("mixed", mixed), ("still", 0 * noise)):
                yield _stream(f"{name}, {count} of {stride} bytes", rows, "ATTRIBUTES")
    for count, kind in ((300, np.uint16), (30_000, np.uint32)):
        faces = np.concatenate([SHEET.faces.ravel(), random.integers(0, count, 3 * count // 3)])[: count // 3 * 3]
        yield _stream(f"triangles of {kind.__name__}", faces.astype(kind), "TRIANGLES")
        yield _stream(f"indices of {kind.__name__}", faces.astype(kind), "INDICES")
    yield from _filtered(random)


def _filtered(random: np.random.Generator) -> Iterator[dict[str, Any]]:
    vectors = random.normal(size=(500, 4)).astype(np.float32)
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    normals = vectors.copy()
    normals[:, :3] /= np.linalg.norm(vectors[:, :3], axis=1, keepdims=True)
    normals[:, 3] = np.sign(vectors[:, 3])
    for stride, bits in ((4, 8), (8, 12)):
        rows = meshopt.encode_filter_oct(normals, stride, bits)
        yield _stream(f"normals of {bits} bits", rows, "ATTRIBUTES", "OCTAHEDRAL")
    yield _stream("quaternions", meshopt.encode_filter_quat(units, 8, 12), "ATTRIBUTES", "QUATERNION")
    yield _stream("floats", meshopt.encode_filter_exp(vectors, 15), "ATTRIBUTES", "EXPONENTIAL")


def _stream(name: str, rows: NDArray[Any], mode: Any, filtered: Any = "NONE") -> dict[str, Any]:
    source = meshopt.encode_gltf_buffer(rows, mode)
    stride = rows.itemsize if rows.ndim == 1 else rows.strides[0]
    decoded = meshopt.decode_gltf_buffer(source, len(rows), stride, mode, filtered)
    told = {"name": name, "count": len(rows), "stride": stride, "mode": mode, "filter": filtered}
    return {**told, "source": _base64(source), "rows": _base64(decoded.tobytes())}


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
