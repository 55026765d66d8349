"""Files that were once misread: small ones of many programs, each with what it means (`misread` of the test data)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.odd.misread import MISREAD, files_of
from tests.support.odd.odd_files import verdict


def test_all_of_them_are_known(data_dir: Path) -> None:
    assert sorted(path.name for path in (data_dir / "misread").iterdir()) == sorted(MISREAD)


@pytest.mark.parametrize("name", MISREAD)
def test_what_was_misread_is_read_as_it_is_meant(name: str, data_dir: Path) -> None:
    assert verdict(files_of(data_dir, name), MISREAD[name]) == ("right", "")
