"""Mono's C# compiler, and Unity's package com.unity.addressables compiled by it on the stand-ins for the engine."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.support.clients.older_csharp import as_older_csharp
from tests.support.repository import ROOT

CLIENT_TESTS = ROOT / "tests" / "clients" / "unity"
PACKAGE = ROOT / "clients" / "unity"
PLAIN = "Capture2vr.Plain.dll"
ENGINE = "UnityEngine.CoreModule.dll"
UNITY = (PLAIN, ENGINE, "Unity.ResourceManager.dll", "Unity.Addressables.dll", "glTFast.dll", "Capture2vr.dll")
"""What `compile_on_unity` makes: of the names that catalogues have, except glTFast's and ours."""
_STAND_INS = ("UnityEngine", "EngineForAddressables", "JsonUtility", "Networking", "UnityEditor", "Unsafe")
_MAGIC, _MAGIC_IN_UNITY = "nameof(ContentCatalogData).GetHashCode()", "0x0de38942"
"""How binary catalogues begin: a hash of Unity's Mono, which others do not have, and later versions as a number."""
_PLAYER = "UNITY_STANDALONE;UNITY_STANDALONE_LINUX;ENABLE_CACHING;UNITY_2018_1_OR_NEWER;UNITY_2019_3_OR_NEWER"
_PLAYER += ";UNITY_2020_1_OR_NEWER;UNITY_2021_1_OR_NEWER;UNITY_2021_2_OR_NEWER;UNITY_2022_1_OR_NEWER"
_PLAYER += ";UNITY_2022_2_OR_NEWER"


@dataclass(frozen=True)
class Compiler:
    """mcs, with what it has made so far in one folder. Warnings are errors; the language is one that Unity 2022 has.

    others  code is not ours: it may be unsafe, in any notation, and warnings are its authors' affair
    """

    folder: Path
    symbols: str = ""
    libraries: Path | None = None
    others: bool = False

    def __call__(self, name: str, sources: Sequence[Path], *references: str) -> Path:
        out = self.folder / name
        kind = "exe" if out.suffix == ".exe" else "library"
        strictness = (
            ("-langversion:latest", "-unsafe", "-warn:0") if self.others else ("-langversion:7.2", "-warnaserror+")
        )
        command = ["mcs", *strictness, f"-target:{kind}", f"-out:{out}", f"-lib:{self.libraries or self.folder}"]
        command += [f"-r:{each}" for each in references] + [f"-define:{self.symbols}"] * bool(self.symbols)
        done = subprocess.run([*command, *map(str, sources)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return out


def has_mono() -> bool:
    """Whether Mono and its compiler are installed."""
    return shutil.which("mcs") is not None and shutil.which("mono") is not None


def compile_plain(compiler: Compiler) -> None:
    """Compile the plain parts of our package, where nothing of the engine is there."""
    compiler(PLAIN, sorted((PACKAGE / "Runtime" / "Plain").glob("*.cs")), "System.Net.Http.dll", "System.Numerics.dll")


def compile_on_unity(folder: Path, addressables: Path, symbols: str) -> Compiler:
    """Compile our package on Unity's own Addressables, each assembly by the name that Unity's has.

    addressables  the package's folder; symbols: what our package is compiled with for that version
    """
    ours = Compiler(folder, symbols)
    theirs = Compiler(folder, ";".join(filter(None, (_PLAYER, symbols))), others=True)
    compile_plain(ours)
    stubs = CLIENT_TESTS / "stubs"
    theirs(ENGINE, [stubs / f"{name}.cs" for name in _STAND_INS])
    runtime = addressables / "Runtime"
    sources = [_older(each, runtime, folder / "source") for each in sorted(runtime.rglob("*.cs"))]
    managed = folder / "source" / "ResourceManager"
    theirs(UNITY[2], [each for each in sources if each.is_relative_to(managed)], ENGINE)
    theirs(UNITY[3], [each for each in sources if not each.is_relative_to(managed)], ENGINE, UNITY[2])
    theirs(UNITY[4], [stubs / "GLTFast.cs"], PLAIN, ENGINE)
    ours(UNITY[5], sorted((PACKAGE / "Runtime").glob("*.cs")), *UNITY[:5])
    return ours


def _older(source: Path, below: Path, into: Path) -> Path:
    """Copy a source file in the notation that the compiler reads."""
    copy = into / source.relative_to(below)
    copy.parent.mkdir(parents=True, exist_ok=True)
    text = as_older_csharp(source.read_text(encoding="utf-8-sig"))
    copy.write_text(text.replace(_MAGIC, _MAGIC_IN_UNITY), encoding="utf-8")
    return copy
