"""`capture2vr keys` in a data folder: what it makes, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from capture2vr.cli.main import app
from capture2vr.errors import BadInput


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder that is not there yet."""
    for name in ("GATEWAY_DATA_DIR", "GATEWAY_DATABASE_URL", "STORAGE_ROOT", "STORAGE_KIND"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "data"


def keys(data: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["keys", *arguments, "--data", str(data)])


@pytest.mark.parametrize("arguments", [("list",), ("revoke", "key_1"), ("rotate", "key_1")])
def test_a_mistyped_data_folder_is_named_and_not_made(data: Path, arguments: tuple[str, ...]) -> None:
    said = keys(data, *arguments).exception
    assert isinstance(said, BadInput)
    assert str(said) == f"{data} does not exist: name the data folder of the gateway with --data"
    assert not data.exists()
    data.mkdir()
    assert str(keys(data, *arguments).exception).startswith(f"{data}: there is no database or store of a gateway")
    assert not list(data.iterdir())


@pytest.mark.parametrize("command", ["check", "restore", "scrub"])
def test_another_folder_is_not_found_whole(data: Path, command: str) -> None:
    data.mkdir()
    said = CliRunner().invoke(app, ["gateway", command, "--data", str(data)]).exception
    assert str(said).startswith(f"{data}: there is no database or store of a gateway")
    assert not list(data.iterdir())


def test_days_without_end_are_refused(data: Path) -> None:
    """No calendar has the day of their end: the key could not be shown, and no list with it in."""
    made = keys(data, "create", "--expires-days", "3650")
    assert (made.exit_code, made.stdout.startswith("c2v_")) == (0, True)
    listed = keys(data, "list").stdout
    key = listed[listed.index("key_") :].split()[0]
    for arguments in (("create", "--expires-days"), ("rotate", key, "--grace-days")):
        assert keys(data, *arguments, "99999999").exit_code == 2
    assert keys(data, "list").stdout == listed
