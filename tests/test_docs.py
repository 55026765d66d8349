"""The examples of README and docs do what they say: commands are run, settings exist, blocks parse."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.cli.up import free_port
from capture2vr.edge.export.ktx2 import VERSION as KTX2_VERSION
from capture2vr.edge.preset import parse_preset
from capture2vr.edge.worker.settings import EdgeSettings, server_security
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.settings import StorageSettings
from tests.conftest import missing
from tests.support.clouds import write_ply
from tests.support.patience import HANG_S
from tests.support.photos.walkaround import render_walkaround
from tests.support.repository import ROOT

PAGES = ("README.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md"))), "deploy/runbook.md")
CODES = {"GATEWAY_STARTING", "STORAGE_FULL"}  # of errors, which are named like settings
VARIABLE = re.compile(r"\b((?:EDGE|GATEWAY|STORAGE)_[A-Z][A-Z0-9_]*)\b")
_ASSIGNMENT = re.compile(r"([A-Z_]+)=(.*)")


@dataclass(frozen=True)
class Block:
    """A block of code on a page: its language as the page names it, and its text."""

    page: str
    language: str
    text: str


def blocks() -> Iterator[Block]:
    for page in PAGES:
        for language, text in re.findall(r"^```(\w*)\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE):
            yield Block(page, language, text)


@dataclass(frozen=True)
class Command:
    """A line of a shell block: the variables before it, the program and its arguments; no comment."""

    page: str
    variables: dict[str, str]
    words: tuple[str, ...]

    @property
    def program(self) -> str:
        return Path(self.words[0]).name if self.words else ""

    def __str__(self) -> str:
        return " ".join([*(f"{name}={value}" for name, value in self.variables.items()), *self.words])


def commands() -> Iterator[Command]:
    for block in blocks():
        if block.language not in ("", "bash") or "FROM " in block.text or "[fit]" in block.text:
            continue
        for line in block.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            variables = {}
            while words and (found := _ASSIGNMENT.fullmatch(words[0])):
                variables[found[1]] = found[2]
                words = words[1:]
            if words or variables:
                yield Command(block.page, variables, tuple(words))


ALL = tuple(commands())


FIRST_STEPS = "docs/start.md"
TASKS = ("README.md", FIRST_STEPS, "docs/capture.md", "docs/gpu.md", "docs/presets.md", "docs/resolution.md")
"""Pages whose examples of commands are run as they stand."""


def of(page: str, *words: str) -> list[Command]:
    """The page's commands of capture2vr that begin with one of these words."""
    return [each for each in ALL if (each.page, each.program) == (page, "capture2vr") and each.words[1] in words]


def without_a_server() -> list[Command]:
    """The tasks' commands that need no server, each once."""
    found = {each.words: each for page in TASKS for each in of(page, "run", "presets", "doctor")}
    return list(found.values())


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to type the examples in, with a scan.ply, a photo.jpg and photos/, as a home of its own.

    The scan is of a rod, which takes half the seconds of a ball: it covers a sixth of each picture.
    """
    folder = tmp_path_factory.mktemp("home")
    rng = np.random.default_rng(3)
    xyz = rng.normal(size=(400, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    write_ply(folder / "scan.ply", xyz * [0.05, 0.3, 0.05], rng.integers(0, 255, (400, 3)))
    rgb = np.full((240, 320, 3), 215, np.uint8)
    rgb[60:200, 100:220] = (30, 60, 170)
    Image.fromarray(rgb).save(folder / "photo.jpg")
    for number, photo in enumerate(render_walkaround(folder / "photos", views=16, size=(480, 360)).photos):
        photo.rename(photo.with_name(f"IMG_{4190 + number}.JPG"))
    return folder


def typed(command: Command, home: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """Run a capture2vr command as the page has it, `more` behind it."""
    arguments = [word.replace("~", str(home)) for word in command.words[1:]]
    return subprocess.run(
        [sys.executable, "-m", "capture2vr.cli", *arguments, *more],
        cwd=home,
        env={**os.environ, "HOME": str(home), "PYTHONPATH": str(ROOT), **command.variables},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )


@pytest.mark.parametrize("page", [*PAGES, "CONTRIBUTING.md", "SECURITY.md"])
def test_a_source_file_that_a_page_names_exists(page: str) -> None:
    """By its name, or by the end of its path; `NAME` stands for what the reader will write."""
    folders = ("clients", "deploy", "docs", "proto", "release", "services", "tests")
    sources = [path.as_posix() for folder in folders for path in (ROOT / folder).rglob("*.*")]
    named = re.findall(r"`([\w./-]+\.(?:py|js|sh|svg))`", (ROOT / page).read_text())
    written = [name for name in named if "NAME" not in name]
    assert [name for name in written if not any(source.endswith(f"/{name}") for source in sources)] == []


def test_the_readme_is_short_and_shows_the_first_commands_of_the_first_steps() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    assert len(text.split()) <= 900
    shown = {" ".join(each.words) for each in of("README.md", "run", "up", "push", "pull")}
    assert len(shown) == 4
    assert shown <= {" ".join(each.words) for each in of(FIRST_STEPS, "run", "up", "push", "pull")}


def test_the_changes_of_the_first_release_are_few_lines() -> None:
    assert len((ROOT / "CHANGELOG.md").read_text().splitlines()) <= 25


def test_the_pages_have_examples() -> None:
    assert len(ALL) > 25
    assert {"capture2vr", "make", "docker", "openssl", "npm", "pip"} <= {command.program for command in ALL}


@pytest.mark.slow
@pytest.mark.parametrize("command", without_a_server(), ids=str)
def test_a_command_of_the_tasks_runs(command: Command, home: Path) -> None:
    ended = typed(command, home)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_the_session_of_the_first_steps_with_a_running_product(home: Path) -> None:
    """`up` in one terminal; push, pull, ls in another; keys, and a signed catalogue read with them."""
    (up,) = of(FIRST_STEPS, "up")
    port = free_port()
    keygen, verify = of(FIRST_STEPS, "catalogue")
    assert (keygen.words[2], verify.words[2]) == ("keygen", "verify")
    assert typed(keygen, home).returncode == 0
    shutil.copy(home / "keys" / "2026.pub", home / "key.pub")
    environment = {**os.environ, "HOME": str(home), "PYTHONPATH": str(ROOT)}
    environment["STORAGE_SIGNING_KEY"] = str(home / "keys" / "2026")
    process = [sys.executable, "-m", "capture2vr.cli", *up.words[1:], "--port", str(port)]
    with subprocess.Popen(process, cwd=home, env=environment, stderr=subprocess.PIPE, text=True) as product:
        assert product.stderr is not None
        try:
            assert any("capture page" in line for line in product.stderr)
            for command in [*of(FIRST_STEPS, "push", "pull", "download", "name", "notes", "ls"), verify]:
                ended = typed(command, home, "--gateway", f"http://127.0.0.1:{port}")
                assert ended.returncode == 0, f"{command}\n{ended.stderr}"
        finally:
            product.send_signal(signal.SIGINT)
    assert product.returncode == 0
    assert (home / "pulled" / "lod0.glb").read_bytes()[:4] == b"glTF"


@pytest.mark.parametrize("command", [each for each in ALL if each.program == "make"], ids=str)
def test_a_target_of_make_exists(command: Command) -> None:
    planned = subprocess.run(["make", "-n", *command.words[1:]], cwd=ROOT, capture_output=True, text=True)
    assert planned.returncode == 0, planned.stderr


def test_the_extras_that_pip_is_to_install_exist() -> None:
    import tomllib

    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = re.findall(
        r"pip install[^\n]*'[^'\n]*\[([\w,-]+)\]'", "\n".join((ROOT / page).read_text() for page in PAGES)
    )
    assert named
    assert {extra for each in named for extra in each.split(",")} <= extras.keys()


def test_the_encoder_of_ktx2_has_the_version_that_the_pages_install() -> None:
    packages = [command.words[-1] for command in ALL if command.program == "npm"]
    assert packages
    assert set(packages) == {f"ktx2-encoder@{KTX2_VERSION}"}


@pytest.mark.parametrize("page", PAGES)
def test_every_setting_that_a_page_names_exists(page: str) -> None:
    known = set()
    for settings in (EdgeSettings, GatewaySettings, StorageSettings):
        prefix = str(settings.model_config["env_prefix"])
        known |= {prefix + field.upper() for field in settings.model_fields}
    compose = set(VARIABLE.findall((ROOT / "docker-compose.yml").read_text()))
    assert set(VARIABLE.findall((ROOT / page).read_text())) - known - compose - CODES == set()


@pytest.mark.parametrize("command", [each for each in ALL if each.words[:2] == ("docker", "compose")], ids=str)
def test_compose_knows_the_variables_profiles_and_services_of_an_example(command: Command) -> None:
    compose = (ROOT / "docker-compose.yml").read_text()
    assert all(f"${{{name}" in compose for name in command.variables)
    for option, value in zip(command.words, command.words[1:], strict=False):
        if option == "--profile":
            assert f"profiles: [{value}]" in compose
    if "run" in command.words:
        assert "\n  gateway:\n" in compose


def test_a_preset_of_ones_own_is_one() -> None:
    (block,) = [block for block in blocks() if "[fit]" in block.text]
    assert parse_preset("mine", block.text).fit is not None


def test_the_certificates_of_the_runbook_are_taken(tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        missing("openssl")
    for command in ALL:
        if command.program == "openssl" and command.words[1] in ("req", "x509"):
            done = subprocess.run(command.words, cwd=tmp_path, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
    settings = EdgeSettings(tls_cert=tmp_path / "edge.crt", tls_key=tmp_path / "edge.key", token="0123456789abcdef")
    assert server_security(settings).credentials is not None


def test_what_a_newcomer_is_told_to_touch_is_there_and_little() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text().partition("## How to add")[2].partition("\n## ")[0]
    lists = re.split(r"^\*\*(.+?)\*\*", text, flags=re.MULTILINE)[1:]
    assert lists[:12:2] == ["A capture format", "A preset", "A target", "A job option", "A route", "A page"]
    assert lists[12::2] == ["A public name of the package", "A sentence of gateway or worker to people"]
    for steps in lists[1::2]:
        assert 1 < len(re.findall(r"^\d\. ", steps, re.MULTILINE)) <= 6
        for path in re.findall(r"`([\w./]+/[\w.-]+)`", steps):
            there = ROOT / path
            assert (there.parent if "NAME" in path else there).exists() or there.parent.name == "NAME", path
