"""Godot 4 without a window, unpacked with its libraries from a newer Debian than this machine's, not installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.support.debian import debian_mirror
from tests.support.npm_packages import kept
from tests.support.patience import HANG_S

_SUITE = "forky"  # the first Debian that has Godot 4
_UNPACK_S = 600
_PROJECT = """config_version=5

[application]

config/name="tests"

[editor_plugins]

enabled=PackedStringArray("res://addons/capture2vr/plugin.cfg")

[debug]

gdscript/warnings/directory_rules={}
"""
_WARNINGS = (  # which are errors here, in addons too
    *("unused_variable", "unused_local_constant", "unused_private_class_variable", "unused_parameter", "unused_signal"),
    *("shadowed_variable", "shadowed_variable_base_class", "shadowed_global_identifier", "unreachable_code"),
    *("standalone_expression", "untyped_declaration", "narrowing_conversion", "static_called_on_instance"),
)


@dataclass(frozen=True)
class Project:
    """A Godot project with our addon in it, whose user data lies in a folder of its own."""

    folder: Path
    home: Path

    def add(self, files: Sequence[Path], below: str = "") -> None:
        """Copy files into the project."""
        (self.folder / below).mkdir(parents=True, exist_ok=True)
        for file in files:
            shutil.copy(file, self.folder / below)

    def import_files(self) -> str:
        """Have the editor import everything, and its plugin with it; return what it prints."""
        return self.run("--import")

    def run(self, *arguments: str) -> str:
        """Run Godot in the project; return what it prints."""
        self.home.mkdir(parents=True, exist_ok=True)
        environment = os.environ | {"HOME": str(self.home), "XDG_DATA_HOME": str(self.home)}
        command = [*_command(), "--headless", "--path", str(self.folder), *arguments]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANG_S)
        return done.stdout + done.stderr


def project(folder: Path, addon: Path) -> Project:
    """A project in a new folder, with the addon of that folder. Skips where Godot cannot be had."""
    _command()
    made = folder / "project"
    shutil.copytree(addon, made / "addons" / addon.name)
    (made / "project.godot").write_text(_PROJECT + "".join(f"gdscript/warnings/{name}=2\n" for name in _WARNINGS))
    return Project(made, folder / "home")


@cache
def _command() -> list[str]:
    """How Godot is started: by its own linker, since its libraries are newer than this machine's."""
    if shutil.which("mmdebstrap") is None:
        pytest.skip("mmdebstrap is missing, to unpack Godot 4")
    folder = kept("godot", _SUITE.encode(), _unpack)
    (linker,) = folder.glob("usr/lib/*/ld-linux-*.so.*")
    libraries = f"{linker.parent}:{linker.parent / 'pulseaudio'}"
    return [str(linker), "--library-path", libraries, str(folder / "usr" / "bin" / "godot")]


def _unpack(scratch: Path) -> None:
    whole = scratch.with_name(f"{scratch.name}.whole")
    # A mirror that is some weeks behind is as good: packages are checked by their signed hashes.
    options = ["--quiet", "--variant=extract", "--include=godot", '--aptopt=Acquire::Check-Valid-Until "false"']
    source = f"deb {debian_mirror()} {_SUITE} main"
    try:
        command = ["mmdebstrap", *options, _SUITE, str(whole), source]
        done = subprocess.run(command, capture_output=True, text=True, timeout=_UNPACK_S)
        if done.returncode != 0:
            pytest.skip(f"Godot 4 cannot be had: {done.stderr.strip().splitlines()[-1:]}")
        for part in ("lib", "bin"):
            shutil.copytree(whole / "usr" / part, scratch / "usr" / part, symlinks=True)
    finally:
        shutil.rmtree(whole, ignore_errors=True)
