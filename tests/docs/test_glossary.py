"""One word for one concept: what the glossary forbids is in no document, on no page of the product, in no sentence of
the services and in nothing that the command line prints.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Iterator

import pytest
from typer.main import get_command

from capture2vr.cli.main import app
from capture2vr.sentences.sentence import english
from tests.support.html_texts import Texts
from tests.support.python_files import python_files
from tests.support.repository import ROOT

PAGES = (
    *("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"),
    *("deploy/README.md", "deploy/runbook.md", "clients/unity/README.md", "clients/godot/README.md"),
    *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md"))),
)
WEB_PAGES = tuple(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "services" / "web").glob("*/*.html")))
_ROW = re.compile(r"^\| \*\*.*\| (?P<meaning>.*) \| (?P<forbidden>[^|]*?) ?\|$", re.MULTILINE)
# Code, what a page calls its own buttons, links' targets, and the glossary's own rows are not prose.
_NO_PROSE = re.compile(
    r"^```.*?^```|`[^`\n]+`|(?<!\*)\*(?!\*)(?:[^*\n]|\n(?!\n))+\*(?!\*)|\b_(?!_)(?:[^_\n]|\n(?!\n))+_\b"
    r"|\]\([^)]*\)|\{ #[^}]*\}|^\| \*\*[^\n]*$",
    re.DOTALL | re.MULTILINE,
)
_NO_TEXT = re.compile(r"`[^`]+`|\{[^{}]*\}|<[^<>]*>")


def forbidden_words() -> list[str]:
    rows = _ROW.finditer((ROOT / "docs" / "glossary.md").read_text())
    return [word.strip() for row in rows for word in row["forbidden"].split(",") if word.strip()]


FORBIDDEN = re.compile(rf"\b(?:{'|'.join(map(re.escape, forbidden_words()))})s?\b", re.IGNORECASE)


def forbidden_in(page: str) -> list[str]:
    """The places of a Markdown page that use a forbidden word in prose."""
    text = _NO_PROSE.sub("`", page)
    return [text[max(0, found.start() - 40) : found.end() + 20] for found in FORBIDDEN.finditer(text)]


def forbidden_among(texts: Iterable[str]) -> list[str]:
    """The texts of pages or services that use a forbidden word: names of values and markup are not prose."""
    return [text for text in texts if FORBIDDEN.search(_NO_TEXT.sub("`", text))]


def help_texts() -> Iterator[tuple[str, str]]:
    """Name and help of every command, and of each of its parameters."""
    todo = [("capture2vr", get_command(app))]
    while todo:
        name, command = todo.pop()
        yield name, command.help or ""
        yield from ((f"{name} {each.name}", str(getattr(each, "help", ""))) for each in command.params)
        todo += [(f"{name} {each}", below) for each, below in getattr(command, "commands", {}).items()]


def test_the_glossary_forbids_something() -> None:
    assert {"thing", "film", "search word", "saved scene"} <= set(forbidden_words())
    assert FORBIDDEN.search("two Things beside each other")
    assert not FORBIDDEN.search("something that is nothing")
    assert forbidden_among(["{things} of <b title='film'>a</b> `thing`", "<b>a</b> film", "{count} things"]) == [
        "<b>a</b> film",
        "{count} things",
    ]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_keeps_to_the_words_of_the_glossary(page: str) -> None:
    assert forbidden_in((ROOT / page).read_text()) == []


@pytest.mark.parametrize("page", WEB_PAGES)
def test_a_page_of_the_product_keeps_to_the_words_of_the_glossary(page: str) -> None:
    texts = Texts((ROOT / page).read_text(encoding="utf-8")).found
    assert len(texts) > 5
    assert forbidden_among(texts) == []


def test_what_pages_and_their_scripts_say_keeps_to_the_words_of_the_glossary() -> None:
    texts = json.loads((ROOT / "services" / "web" / "texts.json").read_text(encoding="utf-8"))  # German by English
    assert len(texts) > 300
    assert forbidden_among(texts) == []


def test_what_the_services_say_keeps_to_the_words_of_the_glossary() -> None:
    assert len(english()) > 900
    assert forbidden_among(english().values()) == []


def printed_texts() -> Iterator[tuple[str, str]]:
    """File and text of every string with a space in the command line's modules, but for docstrings."""
    for name, tree in python_files("cli").items():
        documentation = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and node not in documentation and " " in str(node.value):
                yield name, str(node.value)


def test_what_the_command_line_prints_keeps_to_the_words_of_the_glossary() -> None:
    texts = list(printed_texts())
    assert len(texts) > 500
    assert [(name, text) for name, text in texts if forbidden_among([text])] == []


def test_the_help_of_the_command_line_keeps_to_the_words_of_the_glossary() -> None:
    texts = dict(help_texts())
    assert {"capture2vr run", "capture2vr push tag", "capture2vr keys create"} <= texts.keys()
    assert {name: text for name, text in texts.items() if FORBIDDEN.search(text)} == {}
