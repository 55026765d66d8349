"""German for what gateway and worker say: no sentence of theirs that people see is without, and none is left over."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from capture2vr.gateway.page_texts import german_server_texts
from tests.support.repository import ROOT

SERVICES = ROOT / "services"
SPEAKERS = ("edge", "gateway", "storage")
RAISED = {"ArchiveError", "CaptureError", "EdgeError", "Failure", "Problem", "Refused", "UnreadableError", "limited"}
"""What carries a sentence to people: its arguments are sentences."""
SAID = {"hints", "hint", "detail", "message", "advice", "because", "warnings"}
OF_ENGINEERS = {  # said on a command line, to a program, or in a log alone
    "edge/api",
    "edge/engine",
    "edge/field/device.py",
    "edge/jobs/archived_arrays.py",
    "edge/jobs/available_presets.py",
    "edge/preset.py",
    "edge/single_photo/weights.py",
    "edge/single_photo_training",
    "gateway/resumable/protocol.py",
    "gateway/routes/health.py",
    "gateway/routes/webhooks.py",
    "gateway/webhooks",
    "storage/unity",
}
_TO_PROGRAMS = re.compile(
    r"/v1/|`|Idempotency-Key|multipart|PATCH|HEAD|fields named|STORAGE_|number them from|signing key"
)
_VALUE = re.compile(r"\{[^{}]*\}")


def form(text: str) -> str:
    """A sentence without the names of its values; those that stand side by side are one."""
    return re.sub(r"(\{\})+", "{}", _VALUE.sub("{}", text.replace("\n", " ")))


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


def trees() -> Iterator[tuple[Path, ast.Module]]:
    for speaker in SPEAKERS:
        for path in sorted((SERVICES / speaker).rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def is_of_engineers(path: Path) -> bool:
    name = path.relative_to(SERVICES).as_posix()
    return any(name == each or name.startswith(f"{each}/") for each in OF_ENGINEERS)


def called(node: ast.Call) -> str:
    return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")


def sentences_to_people() -> Iterator[tuple[str, str]]:
    """Each with its place."""
    for path, tree in trees():
        if is_of_engineers(path):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and called(node) in RAISED:
                arguments = [*node.args, *(each.value for each in node.keywords if each.arg in SAID)]
                for text in (text for each in arguments for text in texts_in(each)):
                    if " " in text and re.search("[a-z]", text) and not _TO_PROGRAMS.search(text):
                        yield f"{path.relative_to(ROOT)}:{node.lineno}", text


def of_presets() -> Iterator[str]:
    """What each preset does, and how long that takes where it is long."""
    for path in (SERVICES / "edge" / "presets").rglob("*.toml"):
        preset = tomllib.loads(path.read_text(encoding="utf-8"))
        yield from (preset[name] for name in ("summary", "takes") if name in preset)


def test_every_sentence_to_people_has_a_translation() -> None:
    known = {form(text) for text in german_server_texts()}
    found = [*sentences_to_people(), *(("presets", text) for text in of_presets())]
    assert len(found) > 300
    assert [(place, text) for place, text in found if form(text) not in known] == []


def test_no_translation_is_without_a_sentence() -> None:
    sources = {form(text) for _, tree in trees() for node in ast.walk(tree) if (text := written(node))} | set(
        of_presets()
    )

    def is_said(text: str) -> bool:
        """Whole, or as what is put before, behind or between; `{count} no_overlap` is a number of that kind."""
        parts = {text, text.removeprefix("{}"), text.removesuffix("{}"), text.removeprefix("{}").removesuffix("{}")}
        return not sources.isdisjoint(parts | {text.removeprefix("{} ").replace(" ", "_")})

    assert [text for text in german_server_texts() if not is_said(form(text))] == []


def test_a_translation_has_the_values_of_its_sentence() -> None:
    for text, german in german_server_texts().items():
        values = _VALUE.findall(text)
        assert len(set(values)) == len(values), f"each is told apart by its name: {text}"
        assert sorted(values) == sorted(_VALUE.findall(german)), text
        assert "}{" not in text, f"where one ends and the next begins cannot be seen: {text}"
