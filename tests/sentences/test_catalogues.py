"""The catalogues of what gateway and worker say: no sentence that people see is outside, and none is left over."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from string import Formatter

import pytest
from babel.messages.pofile import read_po

from capture2vr.gateway.languages import LANGUAGES, catalogue_of
from capture2vr.sentences.sentence import HERE, english
from tests.support.python_files import SERVICES, python_files

SPEAKERS = ("edge", "gateway", "order", "process", "storage")
RAISED = {"ArchiveError", "CaptureError", "EdgeError", "Failure", "Problem", "Refused", "UnreadableError", "limited"}
"""What carries a sentence to people: its arguments are sentences."""
SAID = {"hints", "hint", "detail", "message", "advice", "because", "warnings"}
OF_ENGINEERS = {  # said on a command line, to a program, or in a log alone
    "edge/engine",
    "edge/field/device.py",
    "edge/jobs/archived_arrays.py",
    "edge/jobs/available_presets.py",
    "edge/preset.py",
    "gateway/resumable/protocol.py",
    "gateway/routes/health.py",
    "gateway/routes/webhooks.py",
    "gateway/webhooks",
    "storage/unity",
}
_TO_PROGRAMS = re.compile(
    r"/v1/|`|Idempotency-Key|multipart|PATCH|HEAD|fields named|STORAGE_|number them from|signing key"
)


def written(node: ast.AST) -> str | None:
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def texts_in(node: ast.AST) -> Iterator[str]:
    """The texts that an argument may be: of a tuple each, of a condition both."""
    text = written(node)
    if text is not None:
        yield text
    elif isinstance(node, ast.Tuple | ast.List | ast.IfExp | ast.BoolOp | ast.BinOp | ast.Starred):
        for each in ast.iter_child_nodes(node):
            yield from texts_in(each)


@cache
def calls() -> list[tuple[str, ast.Call]]:
    """Every call in the speakers' modules, with its module's name."""
    trees = python_files(*SPEAKERS).items()
    return [(name, node) for name, tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call)]


def is_of_engineers(name: str) -> bool:
    return any(name == each or name.startswith(f"{each}/") for each in OF_ENGINEERS)


def called(node: ast.Call) -> str:
    return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")


def sentences_to_people() -> Iterator[tuple[str, str]]:
    """Each with its place."""
    for name, call in calls():
        if not is_of_engineers(name):
            yield from ((f"{name}:{call.lineno}", text) for text in sentences_of(call))


def sentences_of(call: ast.Call) -> Iterator[str]:
    """The sentences without a code that a call passes on to people."""
    if called(call) not in RAISED:
        return
    arguments = [*call.args, *(each.value for each in call.keywords if each.arg in SAID)]
    for text in (text for each in arguments for text in texts_in(each)):
        if " " in text and re.search("[a-z]", text) and not _TO_PROGRAMS.search(text):
            yield text


def of_presets() -> Iterator[str]:
    """What each preset does, and how long that takes where it is long."""
    for path in (SERVICES / "edge" / "presets").rglob("*.toml"):
        preset = tomllib.loads(path.read_text(encoding="utf-8"))
        yield from (preset[name] for name in ("summary", "takes") if name in preset)


def said() -> Iterator[tuple[str, ast.Call, str]]:
    """Each call of `say` with a code: its place, the call, the code."""
    for name, call in calls():
        if called(call) == "say":
            for code in texts_in(call.args[0]):
                yield f"{name}:{call.lineno}", call, code


def values_in(text: str) -> list[tuple[str, str]]:
    """The values of a sentence, each with its format."""
    return sorted((name, spec or "") for _, name, spec, _ in Formatter().parse(text) if name is not None)


@pytest.mark.slow
@pytest.mark.essential
def test_every_sentence_to_people_has_a_code() -> None:
    assert [(place, text) for place, text in sentences_to_people()] == []
    assert [text for text in of_presets() if text not in english()] == []


def test_the_search_for_sentences_finds_them() -> None:
    tree = ast.parse('raise CaptureError("CODE", f"has {n} points", hints=("walk around it", say("code")))')
    assert [text for node in ast.walk(tree) if isinstance(node, ast.Call) for text in sentences_of(node)] == [
        "has {} points",
        "walk around it",
    ]


def test_every_code_is_in_the_catalogue_and_gets_the_values_of_its_sentence() -> None:
    found = list(said())
    assert len(found) > 900
    assert [(place, code) for place, _, code in found if code not in english()] == []
    for place, call, code in found:
        assert sorted(str(each.arg) for each in call.keywords) == [name for name, _ in values_in(english()[code])], (
            place
        )


def test_no_sentence_is_left_over() -> None:
    trees = python_files(*SPEAKERS).values()
    texts = {text for tree in trees for node in ast.walk(tree) if (text := written(node))}
    assert set(english()) - texts - set(of_presets()) == set()


def test_the_catalogues_are_sorted_by_code_as_git_merges_them_best() -> None:
    assert list(english()) == sorted(english())


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_a_catalogue_has_every_sentence_with_its_values(language: str) -> None:
    path = HERE / "locale" / language / "LC_MESSAGES" / "messages.po"
    with path.open("rb") as file:
        messages = {str(each.context): each for each in read_po(file, locale=language) if each.id}
    assert {code: each.id for code, each in messages.items()} == english()
    assert [code for code, each in messages.items() if each.fuzzy or not each.string] == []
    for code, text in catalogue_of(language).items():
        assert values_in(text) == values_in(english()[code]), code
