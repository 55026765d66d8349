"""A file is the old one or the new one, whatever happens in between."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from capture2vr.process.atomic_write import atomic_write
from tests.support.patience import HANG_S

KILLED = """
import os, signal, sys
from pathlib import Path
from capture2vr.process.atomic_write import atomic_write
with atomic_write(Path(sys.argv[1])) as part:
    part.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("durable", [True, False])
def test_the_new_file_takes_the_place_of_the_old_one(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    with atomic_write(path, durable=durable) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("file", "new")]


def test_a_block_that_raises_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def fail() -> None:
        with atomic_write(path, temporary=tmp_path / "elsewhere") as part:
            part.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("file", "old")]


def test_a_killed_process_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], timeout=HANG_S)
    assert ended.returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    with atomic_write(path) as part:
        part.write_text("new")
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("file", "new")]
