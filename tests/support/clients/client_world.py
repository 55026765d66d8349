"""What the tests of both clients load: assets that the product has published, signed and listed, as folders.

v1/, v2/, removed/   the store before and after a new version of "bowl", and after its removal; "cup" stays beside it
forged/              v2 whose unsigned Unity catalogue gives the bowl, as version 3, the files of the cup
inflated/            v2 whose unsigned Unity catalogue says that the bowl is version 900
spoilt/              v2 whose Unity catalogue offers a third version, of which every file is damaged
partly/              v2 in which the bowl's finest file is missing
flawed/              v2 in which the bowl's finest file has other bytes
damaged/             v2 whose Unity catalogue is none
"""

from __future__ import annotations

import base64
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys, Signer, public_key
from capture2vr.storage.local import LocalStore
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from capture2vr.storage.unity.publication import catalogue_files
from tests.support.clients.unity_tables import TABLE, tabulate


def build(root: Path, private: Ed25519PrivateKey | None = None) -> dict[str, Any]:
    """Publish everything below `root`, signed by a key; the facts that the tests compare with."""
    private = private or Ed25519PrivateKey.generate()
    signer = Signer(public_key(private.public_key().public_bytes_raw()), private)
    keys = Keys((signer,))
    store = LocalStore(root / "store")
    publish(bowl_bundle(0.1), store, key="cup", policy=PublishPolicy(keys))
    publish(bowl_bundle(0.5, picture=b"\x89PNG one"), store, key="bowl", policy=PublishPolicy(keys))
    _snapshot(store, root / "v1")
    publish(bowl_bundle(0.6, picture=b"\x89PNG two"), store, key="bowl", policy=PublishPolicy(keys))
    _snapshot(store, root / "v2")
    lods = read_entry(store, "bowl").document["lods"]
    remove(store, "bowl", keys)
    _snapshot(store, root / "removed")
    _variants(root)
    signatures = _signatures(private)
    return {"key": base64.b64encode(signer.public.raw).decode(), "lods": lods, "signatures": signatures}


def bowl_bundle(radius_m: float, picture: bytes = b"", labels: Sequence[str] = ("kitchen", "round")) -> Bundle:
    """A bowl on the floor, three levels of it; its preview's bytes need be no picture, since no engine reads them."""
    levels = {f"lod{level}.glb": to_glb(_bowl(radius_m, 48 >> level), "meshopt") for level in range(3)}
    lods = [{"file": name, "level": level} for level, name in enumerate(levels)]
    size = [2 * radius_m, radius_m, 2 * radius_m]
    names = {"label": "Bowl", "labels": list(labels)}
    files = {**levels, **({"preview.png": picture} if picture else {})}
    manifest = {**names, "lods": lods, "scale_confidence": "metric", "size_m": size}
    return Bundle(state="preview", files=files, manifest=manifest)


def _bowl(radius_m: float, steps: int) -> Mesh:
    """An open half sphere, its pole on the floor at the origin."""
    around, down = np.meshgrid(np.linspace(0, 2 * np.pi, 4 * steps), np.linspace(0.01, np.pi / 2, steps))
    ring = radius_m * np.sin(down)
    vertices = np.stack((ring * np.cos(around), radius_m * (1 - np.cos(down)), ring * np.sin(around)), axis=-1)
    place = np.arange(vertices[..., 0].size).reshape(down.shape)
    a, b, c, d = place[:-1, :-1], place[:-1, 1:], place[1:, :-1], place[1:, 1:]
    faces = np.concatenate((np.stack((a, b, c), -1).reshape(-1, 3), np.stack((b, d, c), -1).reshape(-1, 3)))
    rgb = np.full((place.size, 3), 120, np.uint8)
    return Mesh(vertices.reshape(-1, 3), faces, rgb)


def _snapshot(store: LocalStore, folder: Path) -> None:
    shutil.copytree(store.root, folder, ignore=shutil.ignore_patterns(".*"))
    tabulate(folder)


def _variants(root: Path) -> None:
    for name in ("forged", "inflated", "spoilt", "partly", "flawed", "damaged"):
        shutil.copytree(root / "v2", root / name)
    bowl, cup = parse_assets(tabulate(root / "v2"))
    _replace(root / "forged", replace(bowl, version=3, files=cup.files), replace(cup, files=bowl.files))
    _replace(root / "inflated", replace(bowl, version=900), cup)
    _replace(root / "spoilt", replace(bowl, version=3, files=tuple(map(_renamed, bowl.files))), cup)
    for file in bowl.files:
        shutil.copy(root / "v2" / file.url, root / "spoilt" / _renamed(file).url)
    (root / "partly" / bowl.files[0].url).unlink()
    finest = root / "flawed" / bowl.files[0].url
    finest.write_bytes(finest.read_bytes()[:-1] + b"?")
    (root / "damaged" / TABLE).write_text("{")


def _renamed(file: LodFile) -> LodFile:
    """The same file under a hash that is not its own."""
    other = file.sha256[::-1]
    return replace(file, sha256=other, url=file.url.replace(file.sha256, other))


def _replace(folder: Path, *listed: Asset) -> None:
    """The Unity catalogues of a folder by others."""
    for name, data in catalogue_files(Catalogue("default", listed), "default"):
        (folder / name).write_bytes(data)
    tabulate(folder)


def _signatures(private: Ed25519PrivateKey) -> list[dict[str, Any]]:
    """Texts with signatures that hold, the same with something changed, and the first test of RFC 8032, 7.1."""
    key = private.public_key().public_bytes_raw()
    cases = []
    for length in (0, 1, 63, 64, 1000):
        message = bytes(range(256)) * 4
        message = message[:length]
        signature = private.sign(message)
        cases += [(key, message, signature, True), (key, message + b"!", signature, False)]
        cases += [(key, message, _flipped(signature, place), False) for place in (0, 40)]
    cases.append((_flipped(key, 3), b"", private.sign(b""), False))
    cases.append((key, b"", _unreduced(private.sign(b"")), False))
    cases.append((bytes.fromhex(_RFC_KEY), b"", bytes.fromhex(_RFC_SIGNATURE), True))
    return [
        {**dict(zip(("key", "message", "signature"), map(_base64, case[:3]), strict=True)), "holds": case[3]}
        for case in cases
    ]


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _flipped(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


def _unreduced(signature: bytes) -> bytes:
    """The same S plus the order of the group: equal in the sum, and forbidden, lest a signature have two spellings."""
    order = 2**252 + 27742317777372353535851937790883648493
    return signature[:32] + (int.from_bytes(signature[32:], "little") + order).to_bytes(32, "little")


_RFC_KEY = "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a"
_RFC_SIGNATURE = (
    "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555"
    "fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b"
)
