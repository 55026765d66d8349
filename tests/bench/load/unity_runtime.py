"""Unity's own Addressables under Mono, with our package, on collections of 10,000 and 5,000 assets.

`python -m tests.bench unity-runtime FOLDER` compiles the runtime of com.unity.addressables out of FOLDER, which has its
`package.json`, on this repository's stand-ins for the engine. That package is under Unity's Companion License: nothing
of it is kept. The table has milliseconds, and requests and bytes of a server on the same machine. Every answer is
compared with what was published, also those of two starts that no row tells of; a wrong one ends the bench.
"""

from __future__ import annotations

import argparse
import base64
import json
import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.earlier_forms import write_waiting_forms
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.root import Index, root_name, sign_index
from capture2vr.storage.catalogue.signing import Keys, Signer, public_key
from capture2vr.storage.catalogue.tree import Draft
from capture2vr.storage.catalogue.unity_update import delete_unity_catalogues
from capture2vr.storage.local import LocalStore
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from capture2vr.storage.unity.publication import catalogue_files
from tests.bench.data_files import DataMissing
from tests.support.clients.client_site import Site, serving
from tests.support.clients.client_world import bowl_bundle
from tests.support.clients.mono import CLIENT_TESTS, PACKAGE, UNITY, compile_on_unity, has_mono

_NAME = "com.unity.addressables"
_PUBLISHED = 20  # assets of each collection that are published, not only listed
_MOST_OF_SMALL = 5000  # assets that a collection may have for Unity to have a catalogue of its own
_COLLECTIONS = ("large", "small", "young")
_LIMIT_S = 300.0  # of one start of the program
_NOTHING = "//"  # part of no address
_STARTS = ("FirstStart", "StartWithoutNetwork", "SecondStart", "OddStart", "StartWithoutSettings")
_SCRIPTS = ("Harness", "Engine", "UnityRuntime")


class MeteredSite(Site):
    """Serves the store below `is/`, and counts that.

    publish/<collection>         publish a version and an asset of it
    turn/off, turn/on            answer 503, and no more
    lose/<part>, damage/<part>   be without the files of whose names that is a part, or have other bytes for them
    meter/now                    how many requests and bytes there were, as two numbers
    """

    def __init__(self, root: Path, publication: Callable[[str], None]) -> None:
        super().__init__(root)
        self._publication = publication
        self._requests = 0
        self._bytes = 0
        self._told = {"turn": "on", "lose": _NOTHING, "damage": _NOTHING}

    def answer(self, way: str, rest: str, key: str) -> tuple[int, bytes, int | None]:
        """Status, body, and the length to announce."""
        if way != "is":
            told = self._obey(way, rest)
            return 200, told, len(told)
        if self._told["turn"] == "off":
            return 503, b"", 0
        body = None if self._told["lose"] in rest else self.content(rest)
        if body is not None and self._told["damage"] in rest:
            body = b"{"
        self._requests += 1
        self._bytes += len(body or b"")
        return (404, b"", 0) if body is None else (200, body, len(body))

    def _obey(self, way: str, rest: str) -> bytes:
        if way in self._told:
            self._told[way] = rest
        elif way == "publish":
            self._publication(rest)
            return b"published"
        return f"{self._requests} {self._bytes}".encode()


@dataclass(frozen=True)
class Publisher:
    """Fills collections of a store, signs them, and counts how often each was changed since."""

    store: LocalStore
    keys: Keys
    changes: Counter[str] = field(default_factory=Counter)

    def fill(self, name: str, count: int) -> dict[str, Any]:
        """Make a collection of so many assets, most of which are only listed; what the program compares with."""
        rows = [_listed(number) for number in range(count - _PUBLISHED)]
        draft = Draft(self.store, name, "first")
        parts, depth = draft.build(rows)
        root = sign_index(Index(name, 1, "2026-01-01T00:00:00Z", parts, depth, "first"), self.keys.signers)
        files = {**draft.written, root_name(name): root}
        if 0 < len(rows) <= _MOST_OF_SMALL:
            files |= dict(catalogue_files(Catalogue(name, tuple(map(_as_unity_has_it, rows))), name))
        for file, data in files.items():
            self.store.put(file, data, content_type="application/json")
        for number in range(_PUBLISHED):
            self._publish(name, number)
        write_waiting_forms()
        lods = read_entry(self.store, f"{name}-000").document["lods"]
        facts = {"count": count, "published": _PUBLISHED, "bytes": sum(lod["bytes"] for lod in lods)}
        added = [f"{name}-{_PUBLISHED + change:03d}" for change in range(2)]
        return {**facts, "old": f"{name}-000", "added": added}

    def change(self, name: str) -> None:
        """Publish a new version of a collection's first asset, and an asset that was not there."""
        self.changes[name] += 1
        self._publish(name, 0)
        self._publish(name, _PUBLISHED - 1 + self.changes[name])
        write_waiting_forms()

    def _publish(self, name: str, number: int) -> None:
        """Publish a bowl whose files nothing else has."""
        radius_m = 0.1 * _COLLECTIONS.index(name) + 0.01 * self.changes[name] + 0.0001 * (number + 1)
        bundle = bowl_bundle(radius_m, labels=("young" if name == "young" else "published",))
        policy = PublishPolicy(self.keys)
        publish(bundle, self.store, key=f"{name}-{number:03d}", collection=name, policy=policy)


def main(arguments: list[str]) -> None:
    """Print a table of what each step takes."""
    options = _parser().parse_args(arguments)
    if options.assets <= _MOST_OF_SMALL:
        raise SystemExit(f"a large collection has more than {_MOST_OF_SMALL} assets")
    version = _version(options.folder)
    symbols = ";".join([*_symbols(version), *options.symbol])
    with tempfile.TemporaryDirectory() as scratch:
        _run(Path(scratch), options, symbols, version)


def _run(scratch: Path, options: argparse.Namespace, symbols: str, version: str) -> None:
    program = _compile(scratch / "made", options.folder, symbols)
    private = Ed25519PrivateKey.generate()
    signer = Signer(public_key(private.public_key().public_bytes_raw()), private)
    publisher = Publisher(LocalStore(scratch / "store"), Keys((signer,)))
    # One less: the asset that is added to it while the app runs has room.
    sizes = dict(zip(_COLLECTIONS, (options.assets, _MOST_OF_SMALL - 1, _PUBLISHED), strict=True))
    facts: dict[str, Any] = {name: publisher.fill(name, count) for name, count in sizes.items()}
    delete_unity_catalogues(publisher.store, "young")
    facts["app"] = str(_app(scratch / "app", version, symbols))
    facts["key"] = base64.b64encode(signer.public.raw).decode()
    site = MeteredSite(publisher.store.root, publisher.change)
    with serving(publisher.store.root, site) as url:
        (scratch / "facts.json").write_text(json.dumps({**facts, "server": url}))
        steps = [step for start in _STARTS for step in _steps(program, start, scratch)]
    print(f"{_NAME} {version}, {symbols or 'no symbols'}; {sizes}\n")
    print("| step | ms | requests | bytes |\n|---|--:|--:|--:|")
    for name, milliseconds, requests, size in steps:
        print(f"| {name} | {milliseconds} | {requests} | {int(size):,} |")


def _compile(folder: Path, addressables: Path, symbols: str) -> Path:
    if not has_mono():
        raise DataMissing("it needs mono with its compiler (mono-mcs, mono-runtime)")
    folder.mkdir()
    compiler = compile_on_unity(folder, addressables, symbols)
    return compiler("UnityRuntime.exe", [CLIENT_TESTS / f"{name}.cs" for name in _SCRIPTS], *UNITY)


def _steps(program: Path, start: str, scratch: Path) -> list[list[str]]:
    """Run one start of the app; its steps. Raises RuntimeError where an answer was wrong."""
    command = ["mono", str(program), start, str(scratch / "facts.json"), str(scratch)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S)
    lines = done.stdout.splitlines()
    if done.returncode or "ok Runs" not in lines:
        raise RuntimeError(f"{start}: {done.stdout}{done.stderr}")
    return [line.split("\t")[1:] for line in lines if line.startswith("step\t")]


def _listed(number: int) -> Row:
    manifest, preview = f"{number:064x}", "1b" * 32
    key = f"capture-{number * 2654435761 % 2**32:08x}"
    return Row(key, f"Chair {number}", ("chair", "wood"), 1, "refined", 1_790_000_000, manifest, preview, 10**6)


def _as_unity_has_it(row: Row) -> Asset:
    hashes = [f"{int(row.manifest, 16) * 3 + level + 1:064x}" for level in range(3)]
    files = (
        LodFile(level, f"assets/{row.key}/lod{level}.{each}.glb", each, 10**6) for level, each in enumerate(hashes)
    )
    return Asset(row.key, row.version, row.labels, tuple(files))


def _app(folder: Path, version: str, symbols: str) -> Path:
    """Write what Unity puts into a player whose app has no assets of its own: settings and an empty catalogue."""
    catalogues = dict(catalogue_files(Catalogue("AddressablesMainContentCatalog", ()), "app"))
    major = int(version.split(".")[0])
    is_json = "ENABLE_JSON_CATALOG" in symbols if major >= 2 else "ENABLE_BINARY_CATALOG" not in symbols
    form = "" if is_json else f"_v{min(3, 1 if major == 1 else 2 if major < 4 else 3)}"
    extension = "json" if is_json else "bin"
    provider = ("Json" if is_json else "Binary") + "CatalogProvider" if major >= 4 else "ContentCatalogProvider"
    (folder / "aa").mkdir(parents=True)
    (folder / "aa" / f"catalog.{extension}").write_bytes(catalogues[f"collections/app/unity/catalog{form}.{extension}"])
    location = {
        "m_Keys": ["AddressablesMainContentCatalog"],
        "m_InternalId": f"{{UnityEngine.AddressableAssets.Addressables.RuntimePath}}/catalog.{extension}",
        "m_Provider": f"UnityEngine.AddressableAssets.ResourceProviders.{provider}",
        "m_Dependencies": [],
        "m_ResourceType": {
            "m_AssemblyName": "Unity.Addressables, Version=0.0.0.0, Culture=neutral, PublicKeyToken=null",
            "m_ClassName": "UnityEngine.AddressableAssets.ResourceLocators.ContentCatalogData",
        },
        "SerializedData": [],
    }
    settings = {
        "m_CatalogLocations": [location],
        "m_LogResourceManagerExceptions": True,
        "m_ExtraInitializationData": [],
        "m_AddressablesVersion": version,
        "m_maxConcurrentWebRequests": 3,
    }
    (folder / "aa" / "settings.json").write_text(json.dumps(settings))
    return folder


def _version(folder: Path) -> str:
    """Return the version of the package in a folder. Raises DataMissing where there is none."""
    try:
        told = json.loads((folder / "package.json").read_text())
    except FileNotFoundError:
        raise DataMissing(f"{folder} has no package.json of {_NAME}") from None
    if told["name"] != _NAME:
        raise DataMissing(f"{folder} has {told['name']}, not {_NAME}")
    return str(told["version"])


def _symbols(version: str) -> list[str]:
    """Return the symbols with which Unity compiles our package beside a version of Addressables."""
    told = json.loads((PACKAGE / "Runtime" / "Capture2vr.asmdef").read_text())["versionDefines"]
    return [each["define"] for each in told if _parts(each["expression"]) <= _parts(version)]


def _parts(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench unity-runtime", description=__doc__)
    parser.add_argument("folder", type=Path, help=f"that of {_NAME}, with its package.json")
    parser.add_argument("--assets", type=int, default=10_000, help="of the large collection: more than 5,000")
    parser.add_argument(
        "--symbol", action="append", default=[], help="of the player, as ENABLE_BINARY_CATALOG or ENABLE_JSON_CATALOG"
    )
    return parser
