"""The Unity package, compiled and run by mono: its plain parts as they are, its engine parts on stubs of the engine."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tests.conftest import missing
from tests.support.clients.client_site import serving
from tests.support.clients.client_world import build
from tests.support.clients.mono import CLIENT_TESTS, PACKAGE, PLAIN, Compiler, compile_plain, has_mono
from tests.support.clients.tree_world import build_trees
from tests.support.patience import HANG_S

_WEBGL = "UNITY_WEBGL"
_ENGINE = (PLAIN, "Stubs.dll", "Capture2vr.dll")
_DEFINES = (
    "",
    "CAPTURE2VR_ADDRESSABLES_2",
    "CAPTURE2VR_ADDRESSABLES_2;CAPTURE2VR_ADDRESSABLES_4",
    "ENABLE_BINARY_CATALOG",
)


@pytest.fixture(scope="module", params=["", _WEBGL], ids=["threads", "webgl"])
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Compiler:
    """The whole package, compiled for players with threads and for the WebGL player, which has none.

    When its plain parts are compiled nothing of the engine is there; the samples are those of a project.
    """
    if not has_mono():
        missing("mono with its compiler (mono-mcs, mono-runtime)")
    compiler = Compiler(tmp_path_factory.mktemp("mono"), request.param)
    compile_plain(compiler)
    stand_ins = (each for each in (CLIENT_TESTS / "stubs").glob("*.cs") if each.stem != "Unsafe")
    compiler("Stubs.dll", sorted(stand_ins), PLAIN)
    compiler("Capture2vr.dll", _runtime(), PLAIN, "Stubs.dll")
    compiler("Samples.dll", sorted((PACKAGE / "Samples~").rglob("*.cs")), *_ENGINE)
    return compiler


def _runtime() -> list[Path]:
    return sorted((PACKAGE / "Runtime").glob("*.cs"))


@pytest.fixture(scope="module")
def facts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A server with what the product has published, and a file that tells the C# side about it."""
    root = tmp_path_factory.mktemp("site")
    private = Ed25519PrivateKey.generate()
    told = build(root, private) | build_trees(root, private)
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
        program = package("PlainTests.exe", _sources("Harness", "PlainTests"), PLAIN)
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
    return [CLIENT_TESTS / f"{name}.cs" for name in names]


def _results(program: Path, facts: Path, scratch: Path) -> dict[str, str]:
    """What each test of a program said: "ok", or why it failed. Seconds that it tells of are for people: pytest -s."""
    command = ["mono", str(program), program.stem, str(facts), str(scratch)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)
    print(*(line for line in done.stdout.splitlines() if line.startswith("seconds ")), sep="\n")
    lines = [re.fullmatch(r"(ok|FAIL) (\w+)(?:: (.*))?", line) for line in done.stdout.splitlines()]
    found = {line[2]: line[3] or line[1] for line in lines if line}
    assert found, done.stdout + done.stderr
    return found


def _tests(file: str) -> list[str]:
    return re.findall(
        r"^    public static (?:async Task|void) (\w+)\(\)", (CLIENT_TESTS / file).read_text(), re.MULTILINE
    )


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
    variant("Capture2vr.dll", _runtime(), PLAIN, "Stubs.dll")


@pytest.mark.slow
def test_the_editor_part_compiles(package: Compiler) -> None:
    package("Capture2vr.Editor.dll", sorted((PACKAGE / "Editor").glob("*.cs")), "Stubs.dll")


@pytest.mark.slow
def test_the_examples_of_the_readme_compile(package: Compiler, tmp_path: Path) -> None:
    blocks = re.findall(r"```csharp\n(.*?)```", (PACKAGE / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 6
    source = tmp_path / "Readme.cs"
    spaces = ("System.Collections.Generic", "System.Threading.Tasks", "Capture2vr", "UnityEngine")
    using = " ".join(f"using {each};" for each in (*spaces, "UnityEngine.AddressableAssets"))
    source.write_text(f"{using} class Readme {{ async Task Run() {{ {''.join(blocks)} }} }}")
    package("Readme.dll", [source], *_ENGINE)
