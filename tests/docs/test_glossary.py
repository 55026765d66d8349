"""One word for one concept: what the glossary forbids is in no document and in no help text of the command line."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from typer.main import get_command

from capture2vr.cli.main import app
from tests.support.repository import ROOT

PAGES = (
    *("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"),
    *("deploy/README.md", "deploy/runbook.md", "clients/unity/README.md", "clients/godot/README.md"),
    *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md"))),
)
TEXTS: tuple[str, ...] = ()
"""Files of the web pages' English texts that keep to the glossary too."""
_ROW = re.compile(r"^\| \*\*.*\| (?P<meaning>.*) \| (?P<forbidden>[^|]*?) ?\|$", re.MULTILINE)
# Code, what a page calls its own buttons, links' targets, and the glossary's own rows are not prose.
_NO_PROSE = re.compile(
    r"^```.*?^```|`[^`\n]+`|(?<!\*)\*(?!\*)[^*\n]+\*(?!\*)|\]\([^)]*\)|\{ #[^}]*\}|^\| \*\*[^\n]*$",
    re.DOTALL | re.MULTILINE,
)


def forbidden_words() -> list[str]:
    rows = _ROW.finditer((ROOT / "docs" / "glossary.md").read_text())
    return [word.strip() for row in rows for word in row["forbidden"].split(",") if word.strip()]


FORBIDDEN = re.compile(rf"\b(?:{'|'.join(map(re.escape, forbidden_words()))})s?\b", re.IGNORECASE)


def forbidden_in(page: str) -> list[str]:
    """The places of a Markdown page that use a forbidden word in prose."""
    text = _NO_PROSE.sub("`", page)
    return [text[max(0, found.start() - 40) : found.end() + 20] for found in FORBIDDEN.finditer(text)]


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


@pytest.mark.parametrize("page", [*PAGES, *TEXTS])
def test_a_page_keeps_to_the_words_of_the_glossary(page: str) -> None:
    assert forbidden_in((ROOT / page).read_text()) == []


def test_the_help_of_the_command_line_keeps_to_the_words_of_the_glossary() -> None:
    texts = dict(help_texts())
    assert {"capture2vr run", "capture2vr push tag", "capture2vr keys create"} <= texts.keys()
    assert {name: text for name, text in texts.items() if FORBIDDEN.search(text)} == {}
