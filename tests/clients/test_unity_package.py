"""The Unity package as Unity's package manager takes it: manifest, assemblies, .meta files."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from capture2vr.storage.unity.listing import FILE_PROVIDER, PREFAB_PROVIDER
from capture2vr.storage.unity.nouns import BASE_URL
from capture2vr.storage.unity.publication import catalogue_names
from tests.conftest import missing
from tests.support.repository import ROOT

PACKAGE = ROOT / "clients" / "unity"


@pytest.fixture(scope="module")
def metas() -> ModuleType:
    """The package's own generator of .meta files."""
    spec = importlib.util.spec_from_file_location("metas", PACKAGE / "Tools~" / "metas.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _json(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def _sources(folder: str) -> dict[str, str]:
    return {path.name: path.read_text() for path in (PACKAGE / folder).glob("*.cs")}


def test_every_asset_has_its_meta_file(metas: ModuleType) -> None:
    assert len(metas.assets()) > 20
    for path in metas.assets():
        assert metas.meta_of(path).read_text() == metas.meta(path), f"run clients/unity/Tools~/metas.py: {path}"


def test_every_meta_file_has_its_asset_and_a_guid_of_its_own() -> None:
    found = sorted(PACKAGE.rglob("*.meta"))
    guids = [match[1] for each in found if (match := re.search(r"^guid: ([0-9a-f]{32})$", each.read_text(), re.M))]
    assert len(set(guids)) == len(guids) == len(found)
    assert [each for each in found if not each.with_suffix("").exists()] == []


def test_the_manifest_is_one(metas: ModuleType) -> None:
    manifest = _json(PACKAGE / "package.json")
    assert manifest["name"] == "com.capture2vr.client"
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest["version"])
    assert re.fullmatch(r"20\d\d\.\d", manifest["unity"])
    assert {"com.unity.addressables", "com.unity.cloud.gltfast"} < set(manifest["dependencies"])
    for version in manifest["dependencies"].values():
        assert re.fullmatch(r"\d+\.\d+\.\d+(-[a-z]+\.\d+)?", version)
    assert all((PACKAGE / sample["path"]).is_dir() for sample in manifest["samples"])
    assert f"## {manifest['version']}" in (PACKAGE / "CHANGELOG.md").read_text()


def test_the_licence_is_that_of_the_repository() -> None:
    assert (PACKAGE / "LICENSE.md").read_text() == (ROOT / "LICENSE").read_text()


def test_assemblies_are_named_after_their_files_and_refer_to_each_other() -> None:
    found = {path: _json(path) for path in PACKAGE.rglob("*.asmdef")}
    names = {document["name"] for document in found.values()}
    assert {path.stem for path in found} == names == {"Capture2vr", "Capture2vr.Plain", "Capture2vr.Editor"}
    for document in found.values():
        assert {name for name in document["references"] if name.startswith("Capture2vr")} <= names
        assert document["noEngineReferences"] == (document["name"] == "Capture2vr.Plain")


def test_the_plain_parts_name_nothing_of_the_engine() -> None:
    for name, text in _sources("Runtime/Plain").items():
        assert "UnityEngine" not in text, name


def test_threads_and_timers_are_behind_one_door() -> None:
    """The WebGL player has none: what needs any goes through the scheduler, and .NET's HTTP client is not for it."""
    door = re.compile(
        r"Task\.Run|Task\.Delay|ThreadPool|\bTimer\b|new Thread\b|ConfigureAwait\(false\)|\.Wait\(\)|CancellationToken"
    )
    found = {path.name for path in (PACKAGE / "Runtime").rglob("*.cs") if door.search(path.read_text())}
    assert found == {"Background.cs", "Fetching.cs"}
    users = {path.name for path in PACKAGE.rglob("*.cs") if "System.Net" in path.read_text()}
    assert users == {"Fetching.cs"}
    assert not any(door.search(path.read_text()) for path in (PACKAGE / "Samples~").rglob("*.cs"))


def test_the_browsers_storage_is_found_by_its_name_and_only_in_a_browser(metas: ModuleType) -> None:
    path = PACKAGE / "Runtime" / "Plugins" / "WebGL" / "Capture2vr.jslib"
    name = re.search(r"static extern void (\w+)\(\);", _sources("Runtime/Plain")["Storage.cs"])
    assert name is not None
    assert re.search(rf"^  {name[1]}: function \(\)", path.read_text(), re.MULTILINE)
    platforms = re.findall(r"- first:\n      (\w+):.*\n    second:\n      enabled: (\d)", metas.meta(path))
    assert dict(platforms) == {"Any": "0", "Editor": "0", "WebGL": "1"}


def test_the_browsers_storage_copies_once_at_a_time_and_misses_nothing() -> None:
    library = PACKAGE / "Runtime" / "Plugins" / "WebGL" / "Capture2vr.jslib"
    if shutil.which("node") is None:
        missing("node, to run the plugin of the WebGL player")
    command = ["node", Path(__file__).parent / "unity" / "storage.mjs", library]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [1, 1, 1, 2, 2, 3]


@pytest.mark.parametrize("provider", [FILE_PROVIDER, PREFAB_PROVIDER])
def test_the_catalogues_name_classes_that_are_there_and_kept(provider: Any) -> None:
    assert _json(PACKAGE / "Runtime" / "Capture2vr.asmdef")["name"] == provider.assembly
    namespace, _, name = provider.name.rpartition(".")
    text = _sources("Runtime")[f"{name}.cs"]
    assert f"namespace {namespace}\n" in text
    assert re.search(rf"\[Preserve\]\s+public sealed class {name} : ResourceProviderBase", text)
    assert re.search(rf"\[Preserve\]\s+public {name}\(\)", text)


def test_the_property_that_addresses_begin_with_is_there_and_kept() -> None:
    kind, _, name = BASE_URL.strip("{}").rpartition(".")
    text = _sources("Runtime")["Catalogue.cs"]
    assert re.search(rf"\[Preserve\]\s+public static class {kind.removeprefix('Capture2vr.')}\n", text)
    assert re.search(rf"\[Preserve\]\s+public static string {name} =>", text)
    assert f'"{BASE_URL.strip("{}")}"' in text


def test_the_files_that_it_asks_for_are_those_that_are_published() -> None:
    text = _sources("Runtime")["Catalogue.cs"]
    asked = {f"collections/default/unity/{name}" for name in re.findall(r'return "(catalog[^"]*)"', text)}
    assert asked == {names.catalogue for names in catalogue_names("default")}
    assert '$"{baseUrl}/collections/{collection}/unity"' in _sources("Runtime")["UnityCatalogue.cs"]


def test_the_linker_keeps_what_only_catalogues_name() -> None:
    root = ET.parse(PACKAGE / "Runtime" / "link.xml").getroot()
    kept = {each.attrib["fullname"] for each in root.iter() if "fullname" in each.attrib}
    assert {"Capture2vr", "UnityEngine.ResourceManagement.ResourceProviders.AssetBundleRequestOptions"} <= kept
    assert "AlwaysLinkAssembly" in _sources("Runtime")["AssemblyInfo.cs"]
