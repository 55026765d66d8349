"""Every command of README, deploy/README and runbook is one that its program takes.

Those of compose that change something are run in an engine too: tests/deploy/test_compose_stack.py.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pytest
import typer
import yaml

from capture2vr.cli.main import app
from tests.conftest import missing
from tests.support.repository import ROOT

PAGES = ("README.md", "deploy/README.md", "deploy/runbook.md")
_SHELL = {"cd", "echo", "export", "git", "mkdir", "sed", "tail"}
_ASSIGNMENT = re.compile(r"[A-Za-z_]\w*=.*", re.DOTALL)
_BUILDERS = {"npm", "pip", "ray"}  # packages, whose names and versions other tests compare
_CLUSTER = {"helm", "kubectl"}  # the chart's tests render what they are given
_SERVICES = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]


@dataclass(frozen=True)
class Command:
    """A command of a page, without the variables before it."""

    page: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return " ".join(self.words)


def blocks(page: str) -> Iterator[str]:
    """The blocks of a page that are for a shell, but for those that test_kubernetes_in_an_hour.py runs."""
    whole = re.sub(r"^<!-- kubernetes: .*?^```.*?^```", "", (ROOT / page).read_text(), flags=re.DOTALL | re.MULTILINE)
    for language, text in re.findall(r"^```(\w*)\n(.*?)^```", whole, re.DOTALL | re.MULTILINE):
        if language in ("", "bash") and not re.search(r"^(FROM |\[fit\]|[A-Z_]+=\S*$)", text, re.MULTILINE):
            yield text


def lines(page: str) -> Iterator[str]:
    """Lines of the blocks, and what of the text is a command with its arguments."""
    for block in blocks(page):
        yield from block.replace("\\\n", " ").splitlines()
    text = re.sub(r"^```.*?^```", "", (ROOT / page).read_text(), flags=re.DOTALL | re.MULTILINE)
    for spans in re.findall(r"`([^`\n]+(?:\n[^`\n]+)?)`", text):
        if re.match(r"(capture2vr \S+ \S|docker |make |bash )[a-z-]", spans) and "|" not in spans and "…" not in spans:
            yield spans.replace("\n", " ")


def commands() -> Iterator[Command]:
    found = set()
    for page in PAGES:
        for line in lines(page):
            words = shlex.split(line.replace("$(", "(").replace("(docker", "( docker"), comments=True)
            for part in _parts(words):
                if part and part not in found:
                    found.add(part)
                    yield Command(page, part)


def _parts(words: list[str]) -> Iterator[tuple[str, ...]]:
    """The commands of a line: between operators and in $( ), without the variables before them."""
    part: list[str] = []
    for word in [*words, ";"]:
        if word in ("|", "&&", ";"):
            yield tuple(part)
            part = []
        elif word.endswith("=(") or word == "(":
            part = []
        elif part or not _ASSIGNMENT.fullmatch(word):
            part.append(word.removesuffix(")") if "(" not in word else word)


ALL = tuple(commands())


def of(*programs: str) -> list[Command]:
    return [each for each in ALL if each.words[0] in programs]


@pytest.mark.parametrize("page", PAGES)
def test_every_block_is_one_that_a_shell_takes(page: str) -> None:
    for block in blocks(page):
        done = subprocess.run(["bash", "-n"], input=block, capture_output=True, text=True)
        assert done.returncode == 0, f"{block}\n{done.stderr}"


def test_every_command_is_looked_at_by_a_test() -> None:
    looked_at = {"capture2vr", ".venv/bin/capture2vr", "docker", "make", "bash", "sudo", "openssl"}
    known = looked_at | _SHELL | _BUILDERS | _CLUSTER
    assert {each.words[0] for each in ALL} <= known, "say in this file how it is looked at"
    assert len(of("docker")) > 25
    assert len(of("capture2vr", ".venv/bin/capture2vr")) > 15


UsageError = typer.BadParameter.__base__  # of the parser that typer brings along


def parse(words: Sequence[str], command: Any = None, parent: Any = None) -> None:
    """Parse a command line of capture2vr, without running it. Raises UsageError."""
    command = command or typer.main.get_command(app)
    context = command.make_context(str(command.name), list(words), parent=parent)
    rest = [*context._protected_args, *context.args]
    if hasattr(command, "resolve_command") and rest:
        _, found, left = command.resolve_command(context, rest)
        parse(left, found, context)


@pytest.mark.parametrize("command", of("capture2vr", ".venv/bin/capture2vr"), ids=str)
def test_a_command_of_the_product_has_these_arguments(command: Command) -> None:
    parse(command.words[1:])


def test_an_argument_that_is_none_is_found() -> None:
    for words in (("gateway", "migrat"), ("backup", "create", "/b", "--kep", "1"), ("backup", "restore")):
        assert UsageError is not None
        with pytest.raises(UsageError):
            parse(words)


@pytest.fixture(scope="module")
def flags(compose_plugin: list[str]) -> Callable[[tuple[str, ...]], set[str]]:
    """The flags of a command of docker, as its own help has them."""

    def told(words: tuple[str, ...]) -> set[str]:
        done = subprocess.run([*compose_plugin, *words, "--help"], capture_output=True, text=True)
        assert done.returncode == 0, (words, done.stderr)
        return set(re.findall(r"(?:^|[\s,])(--?[a-zA-Z][\w-]*)", done.stdout))

    return told


@pytest.fixture(scope="module")
def compose_plugin(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The docker command line, which has compose."""
    if shutil.which("docker") is None:
        missing("the docker command line")
    if subprocess.run(["docker", "compose", "version"], capture_output=True).returncode == 0:
        return ["docker"]
    folder = tmp_path_factory.mktemp("docker")
    script = ROOT / "tests" / "deploy" / "compose-plugin.sh"
    if subprocess.run(["bash", str(script), str(folder)]).returncode != 0:
        missing("docker compose version 2")
    return ["env", f"DOCKER_CONFIG={folder}", "docker"]


_WITH_VALUE = {"--profile", "--scale", "--user", "--cap-add", "-v", "-e", "-f", "--entrypoint"}


@pytest.mark.slow
@pytest.mark.docker
@pytest.mark.parametrize("command", of("docker"), ids=str)
def test_a_command_of_docker_has_these_flags_and_services(
    command: Command, flags: Callable[[tuple[str, ...]], set[str]]
) -> None:
    words = list(command.words[1:])
    called: tuple[str, ...] = ()
    known: set[str] = set()
    is_compose = words[0] == "compose"
    depth = 2 if is_compose or words[0] == "volume" else 1
    while words and (len(called) < depth or words[0].startswith("-")):
        word = words.pop(0)
        if not word.startswith("-"):
            called = (*called, word)
            known = set()
            continue
        known = known or flags(called)
        assert word.partition("=")[0] in known or re.fullmatch(r"-[a-z]{2}", word), f"{word}: {sorted(known)}"
        if word in _WITH_VALUE and (word, called[-1]) != ("-v", "down"):  # there it is the volumes
            words.pop(0)
    assert len(called) == depth
    flags(called)
    if is_compose and called[1] in ("run", "exec"):
        _check_inner(called[1], words)
    elif is_compose:
        assert set(words) <= _SERVICES.keys()


def _check_inner(called: str, words: list[str]) -> None:
    """What a container is to run: by the image's entrypoint, or by that of its service."""
    service, *inner = words
    entrypoint = _SERVICES[service].get("entrypoint", ["capture2vr"])
    if called == "run" and inner:
        assert entrypoint[0] == "capture2vr"
        parse((*entrypoint[1:], *inner))


@pytest.mark.parametrize("command", of("bash"), ids=str)
def test_a_script_exists(command: Command) -> None:
    assert (ROOT / command.words[1]).is_file()


@pytest.mark.parametrize("command", [*of("helm"), *of("make")], ids=str)
def test_files_and_targets_exist(command: Command) -> None:
    for word in command.words[1:]:
        if word.startswith("deploy/"):
            assert (ROOT / word).exists()
    if command.words[0] == "make":
        planned = subprocess.run(["make", "-n", *command.words[1:]], cwd=ROOT, capture_output=True, text=True)
        assert planned.returncode == 0, planned.stderr


def test_what_the_service_backup_runs_by_itself_is_a_command() -> None:
    """With a folder of keys and without one, as compose fills it in."""
    line = str(_SERVICES["backup"]["command"])
    for keys in ("--keys /keys", ""):
        text = line.replace("${KEYS:+--keys /keys}", keys)
        parse(("backup", *shlex.split(re.sub(r"\$\{\w+:-(\w+)\}", r"\1", text))))
    parse(tuple(_SERVICES["migrate"]["command"]))
