"""What the tests of clients load besides `client_world`: trees, and Unity catalogues that are missing or behind.

tree0/, tree1/, tree2/  the assets of v2 and a dozen of rows without files, in trees of that depth; no Unity catalogues
older/                  tree2 of a version before it
flat/                   v2 as a store of an earlier release: without root.json
large1/, large2/        10,000 rows with the bowl of v1, and of v2; no Unity catalogues; a change here and there
behind/                 v2 whose Unity catalogue is still that of v1
unlisted/               v2 whose Unity catalogue does not have the bowl yet
young/                  v2 without Unity catalogues
"""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.local import LocalStore
from capture2vr.storage.unity.locations import build_listing
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from capture2vr.storage.unity.publication import catalogue_files
from tests.support.clients.catalogue_trees import Shape, TreeRow, tree_objects
from tests.support.clients.unity_tables import tabulate

LARGE = 10_000
_LISTED = 300  # of the large collection's rows have a manifest: enough for every kind of it
_COLLECTION = Path("collections") / "default"


def build_trees(root: Path, private: Ed25519PrivateKey) -> dict[str, Any]:
    """Write the folders beside those of `client_world.build`, signed by the same key; the facts to compare with."""
    small = sorted([*_things(root / "v2"), *_fillers(12)], key=lambda row: row.key)
    for depth in range(3):
        _write(root, f"tree{depth}", tree_objects(small, 17, Shape(depth, 2, 2), private))
    _write(root, "older", tree_objects(small, 16, Shape(2, 2, 2), private))
    _behind(root)
    listed = _large(root, private)
    (root / "large2" / "listed.json").write_text(json.dumps(asdict(build_listing(Catalogue("", tuple(listed))))))
    keys = [row.key for row in small if not row.removed]
    return {"tree_keys": keys, "large": LARGE, "listed": [asset.key for asset in listed]}


def _things(store: Path) -> list[TreeRow]:
    found = [read_entry(LocalStore(store), key) for key in ("bowl", "cup")]
    return [
        TreeRow(each.key, each.document["manifest"]["sha256"], each.version, "Bowl", ("kitchen", "round"))
        for each in found
    ]


def _fillers(count: int) -> list[TreeRow]:
    """Assets without files, the sixth of which was removed; some keys come before those of the bowl, some after."""
    return [
        TreeRow(
            f"{'az'[number % 2]}-{number:05d}", hashlib.sha256(str(number).encode()).hexdigest(), removed=number == 6
        )
        for number in range(count)
    ]


def _write(root: Path, name: str, objects: dict[str, bytes], files: str = "v2") -> None:
    """A folder with the assets of another one and this catalogue."""
    shutil.copytree(root / files / "assets", root / name / "assets")
    for place, data in objects.items():
        path = root / name / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def _behind(root: Path) -> None:
    for name in ("flat", "behind", "unlisted", "young"):
        shutil.copytree(root / "v2", root / name)
    (root / "flat" / _COLLECTION / "root.json").unlink(missing_ok=True)
    for name in ("behind", "young"):
        shutil.rmtree(root / name / _COLLECTION / "unity")
    shutil.copytree(root / "v1" / _COLLECTION / "unity", root / "behind" / _COLLECTION / "unity")
    cup = _asset(root / "v2", "cup")
    for name, data in catalogue_files(Catalogue("default", (cup,)), "default"):
        (root / "unlisted" / name).write_bytes(data)
    tabulate(root / "unlisted")


def _asset(store: Path, key: str) -> Asset:
    entry = read_entry(LocalStore(store), key)
    files = (LodFile(each["level"], each["name"], each["sha256"], each["bytes"]) for each in entry.document["lods"])
    return Asset(key, entry.version, (), tuple(files))


def _large(root: Path, private: Ed25519PrivateKey) -> list[Asset]:
    """Write large1 and large2; the assets of large2 that can be located."""
    fillers = [
        TreeRow(
            f"asset-{number:05d}", "", label=f"Asset {number}", labels=("rare",) if number % 100 == 0 else ("often",)
        )
        for number in range(LARGE - 2)
    ]
    assets = [_made_up(number, row.key) for number, row in enumerate(fillers[:_LISTED])]
    manifests = [_manifest(asset) for asset in assets]
    rows = [
        replace(row, manifest=hashlib.sha256(manifests[number] if number < _LISTED else row.key.encode()).hexdigest())
        for number, row in enumerate(fillers)
    ]
    _write(root, "large1", tree_objects([*rows, *_things(root / "v1")], 101, Shape(2), private), "v1")
    changed = [replace(row, removed=True) if row.key == "asset-00100" else row for row in rows]
    _write(root, "large2", tree_objects([*changed, *_things(root / "v2")], 102, Shape(2), private))
    for name in ("large1", "large2"):
        for row, manifest in zip(rows, manifests, strict=False):
            folder = root / name / "assets" / row.key
            folder.mkdir()
            (folder / f"manifest.{row.manifest}.json").write_bytes(manifest)
    there = [asset for asset in assets if asset.key != "asset-00100"]
    return [*there, _asset(root / "v2", "bowl"), _asset(root / "v2", "cup")]


def _made_up(number: int, key: str) -> Asset:
    """An asset of one to four levels, some of them left out."""
    levels = [level for level in range(5) if (number + 1) >> level & 1] or [0]
    files = []
    for level in levels:
        sha256 = hashlib.sha256(f"{key} {level}".encode()).hexdigest()
        files.append(LodFile(level, f"assets/{key}/lod{level}.{sha256}.glb", sha256, 1 + number * 977 + level))
    return Asset(key, 1, (), tuple(files))


def _manifest(asset: Asset) -> bytes:
    """Levels in any order, as a manifest may have them."""
    lods = [
        {"level": file.level, "name": file.url, "sha256": file.sha256, "bytes": file.size}
        for file in sorted(asset.files, key=lambda file: file.sha256)
    ]
    return json.dumps({"lods": lods, "scale_confidence": "metric"}).encode()
