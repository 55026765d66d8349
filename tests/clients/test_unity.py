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
from tests.support.patience import HANG_S
from tests.support.repository import ROOT
from tests.support.unity_site import serving
from tests.support.unity_world import build

_HERE = Path(__file__).parent / "unity"
_PACKAGE = ROOT / "clients" / "unity"
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

    def __call__(self, name: str, sources: list[Path], *references: str, defines: str = "") -> Path:
        out = self.folder / name
        kind = "exe" if out.suffix == ".exe" else "library"
        command = ["mcs", "-langversion:7.2", "-warnaserror+", f"-target:{kind}", f"-out:{out}", f"-lib:{self.folder}"]
        command += [f"-r:{each}" for each in references] + [f"-define:{defines}"] * bool(defines)
        done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return out


@pytest.fixture(scope="module")
def compiler(tmp_path_factory: pytest.TempPathFactory) -> Compiler:
    if shutil.which("mcs") is None or shutil.which("mono") is None:
        missing("mono with its compiler (mono-mcs, mono-runtime)")
    return Compiler(tmp_path_factory.mktemp("mono"))


@pytest.fixture(scope="module")
def plain(compiler: Compiler) -> Path:
    """The parts that know no engine: nothing of it is there when they are compiled."""
    sources = sorted((_PACKAGE / "Runtime" / "Plain").glob("*.cs"))
    return compiler("Capture2vr.Plain.dll", sources, "System.Net.Http.dll", "System.Numerics.dll")


@pytest.fixture(scope="module")
def engine(compiler: Compiler, plain: Path) -> Path:
    """The parts that call the engine, on stubs of it."""
    compiler("Stubs.dll", sorted((_HERE / "stubs").glob("*.cs")), plain.name)
    return compiler("Capture2vr.dll", sorted((_PACKAGE / "Runtime").glob("*.cs")), plain.name, "Stubs.dll")


@pytest.fixture(scope="module")
def samples(compiler: Compiler, engine: Path) -> Path:
    """The samples, as a project has them once it has imported them."""
    sources = sorted((_PACKAGE / "Samples~").rglob("*.cs"))
    return compiler("Samples.dll", sources, "Capture2vr.Plain.dll", "Stubs.dll", engine.name)


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
def plain_results(
    compiler: Compiler, plain: Path, facts: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    program = compiler("PlainTests.exe", [_HERE / "Harness.cs", _HERE / "PlainTests.cs"], plain.name)
    return _results(program, facts, tmp_path_factory.mktemp("plain"))


@pytest.fixture(scope="module")
def engine_results(
    compiler: Compiler, engine: Path, samples: Path, facts: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    sources = [_HERE / "Harness.cs", _HERE / "EngineTests.cs"]
    references = ("Capture2vr.Plain.dll", "Stubs.dll", engine.name, samples.name)
    program = compiler("EngineTests.exe", sources, *references)
    return _results(program, facts, tmp_path_factory.mktemp("engine"))


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
    assert plain_results[name] == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("name", _tests("EngineTests.cs"))
def test_engine(engine_results: dict[str, str], name: str) -> None:
    assert engine_results[name] == "ok"


@pytest.mark.parametrize("defines", _DEFINES)
def test_every_addressables_finds_its_code(compiler: Compiler, engine: Path, defines: str) -> None:
    sources = sorted((_PACKAGE / "Runtime").glob("*.cs"))
    compiler("Variant.dll", sources, "Capture2vr.Plain.dll", "Stubs.dll", defines=defines)


def test_the_editor_part_and_the_samples_compile(compiler: Compiler, samples: Path) -> None:
    compiler("Capture2vr.Editor.dll", sorted((_PACKAGE / "Editor").glob("*.cs")), "Stubs.dll")
    assert samples.exists()


def test_the_examples_of_the_readme_compile(compiler: Compiler, engine: Path, tmp_path: Path) -> None:
    blocks = re.findall(r"```csharp\n(.*?)```", (_PACKAGE / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 5
    source = tmp_path / "Readme.cs"
    using = "using System.Collections.Generic; using System.Threading.Tasks; using Capture2vr; using UnityEngine;"
    source.write_text(f"{using} class Readme {{ async Task Run() {{ {''.join(blocks)} }} }}")
    compiler("Readme.dll", [source], "Capture2vr.Plain.dll", "Stubs.dll", engine.name)
