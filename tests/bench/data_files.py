"""Where benches find the test data, whose missing files they name in one sentence, and where they keep pictures."""

from __future__ import annotations

from pathlib import Path

from tests.conftest import data_folder

PICTURES = Path(__file__).parent / "results" / "pictures"  # that the pages of results show


class DataMissing(Exception):  # noqa: N818 - it reads as what it is
    """A file that a bench needs is not there, or cannot be read; the message says which and what to do."""


def data_file(name: str) -> Path:
    """The path of a file or folder of the test data, by its name in it. Raises DataMissing."""
    path = data_folder() / name
    if not path.exists():
        raise DataMissing(f"{path} is missing: CAPTURE2VR_DATA names the folder of the test data")
    return path
