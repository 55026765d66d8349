"""The Unity package, compiled and run by mono: its plain parts as they are, its engine parts on stubs of the engine."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import missing
from tests.support.clients.client_site import serving
from tests.support.clients.client_world import build
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

_HERE = Path(__file__).parent / "unity"
_PACKAGE = ROOT / "clients" / "unity"
_WEBGL = "UNITY_WEBGL"
_PLAIN = "Capture2vr.Plain.dll"
_ENGINE = (_PLAIN, "Stubs.dll", "Capture2vr.dll")
_DEFINES = (
    "",
    "CAPTURE2VR_ADDRESSABLES_2",
    "CAPTURE2VR_ADDRESSABLES_2;CAPTURE2VR_ADDRESSABLES_4",
    "ENABLE_BINARY_CATALOG",
)


@dataclass(frozen=True)
class Compiler:
    """mcs, with what it has made so far in one folder. Warnings are errors; the language is one that Unity 2022 has."""

    folder: Path
    symbols: str = ""
    libraries: Path | None = None

    def __call__(self, name: str, sources: list[Path], *references: str) -> Path:
        out = self.folder / name
        kind = "exe" if out.suffix == ".exe" else "library"
        command = [
            "mcs",
            "-langversion:7.2",
            "-warnaserror+",
            f"-target:{kind}",
            f"-out:{out}",
            f"-lib:{self.libraries or self.folder}",
        ]
        command += [f"-r:{each}" for each in references] + [f"-define:{self.symbols}"] * bool(self.symbols)
        done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return out


@pytest.fixture(scope="module", params=["", _WEBGL], ids=["threads", "webgl"])
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Compiler:
    """The whole package, compiled for players with threads and for the WebGL player, which has none.

    When its plain parts are compiled nothing of the engine is there; the samples are those of a project.
    """
    if shutil.which("mcs") is None or shutil.which("mono") is None:
        missing("mono with its compiler (mono-mcs, mono-runtime)")
    compiler = Compiler(tmp_path_factory.mktemp("mono"), request.param)
    compiler(
        _PLAIN, sorted((_PACKAGE / "Runtime" / "Plain").glob("*.cs")), "System.Net.Http.dll", "System.Numerics.dll"
    )
    compiler("Stubs.dll", sorted((_HERE / "stubs").glob("*.cs")), _PLAIN)
    compiler("Capture2vr.dll", _runtime(), _PLAIN, "Stubs.dll")
    compiler("Samples.dll", sorted((_PACKAGE / "Samples~").rglob("*.cs")), *_ENGINE)
    return compiler


def _runtime() -> list[Path]:
    return sorted((_PACKAGE / "Runtime").glob("*.cs"))


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A server with what the product has published, and a file that tells the C# side about it."""
    root = tmp_path_factory.mktemp("site")
    told = build(root)
    with serving(root) as url:
        path = root / "facts.json"
        path.write_text(json.dumps({"server": url, **told}))
        yield path


@pytest.fixture(scope="module")
def plain_results(package: Compiler, facts: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Without the engine, but for the WebGL player, where only the engine can fetch."""
    if package.symbols == _WEBGL:
        program = package("PlainTests.exe", _sources("Harness", "Engine", "PlainTests"), *_ENGINE)
    else:
        program = package("PlainTests.exe", _sources("Harness", "PlainTests"), _PLAIN)
    return _results(program, facts, tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def engine_results(package: Compiler, facts: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    program = package("EngineTests.exe", _sources("Harness", "Engine", "EngineTests"), *_ENGINE, "Samples.dll")
    return _results(program, facts, tmp_path_factory.mktemp("engine"))


@pytest.fixture(scope="module")
def http_results(package: Compiler, facts: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    program = package("UnityHttpTests.exe", _sources("Harness", "Engine", "UnityHttpTests"), *_ENGINE)
    return _results(program, facts, tmp_path_factory.mktemp("http"))


def _sources(*names: str) -> list[Path]:
    return [_HERE / f"{name}.cs" for name in names]


def _results(program: Path, facts: Path, scratch: Path) -> dict[str, str]:
    """What each test of a program said: "ok", or why it failed."""
    command = ["mono", str(program), program.stem, str(facts), str(scratch)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)
    lines = [re.fullmatch(r"(ok|FAIL) (\w+)(?:: (.*))?", line) for line in done.stdout.splitlines()]
    found = {line[2]: line[3] or line[1] for line in lines if line}
    assert found, done.stdout + done.stderr
    return found


def _tests(file: str) -> list[str]:
    return re.findall(r"^    public static (?:async Task|void) (\w+)\(\)", (_HERE / file).read_text(), re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("name", _tests("PlainTests.cs"))
def test_plain(plain_results: dict[str, str], name: str) -> None:
    assert plain_results.get(name, "not run: one before it hangs") == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("name", _tests("EngineTests.cs"))
def test_engine(engine_results: dict[str, str], name: str) -> None:
    assert engine_results.get(name, "not run: one before it hangs") == "ok"


@pytest.mark.slow
def test_unity_http(http_results: dict[str, str]) -> None:
    """All at once: some of its tests are for one kind of player only."""
    assert len(http_results) > 7
    assert set(http_results.values()) == {"ok"}


@pytest.mark.slow
@pytest.mark.parametrize("defines", _DEFINES)
def test_every_addressables_finds_its_code(package: Compiler, tmp_path: Path, defines: str) -> None:
    symbols = ";".join(filter(None, (package.symbols, defines)))
    variant = Compiler(tmp_path, symbols, package.folder)
    variant("Capture2vr.dll", _runtime(), _PLAIN, "Stubs.dll")


@pytest.mark.slow
def test_the_editor_part_compiles(package: Compiler) -> None:
    package("Capture2vr.Editor.dll", sorted((_PACKAGE / "Editor").glob("*.cs")), "Stubs.dll")


@pytest.mark.slow
def test_the_examples_of_the_readme_compile(package: Compiler, tmp_path: Path) -> None:
    blocks = re.findall(r"```csharp\n(.*?)```", (_PACKAGE / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 5
    source = tmp_path / "Readme.cs"
    using = "using System.Collections.Generic; using System.Threading.Tasks; using Capture2vr; using UnityEngine;"
    source.write_text(f"{using} class Readme {{ async Task Run() {{ {''.join(blocks)} }} }}")
    package("Readme.dll", [source], *_ENGINE)
