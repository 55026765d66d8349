"""Temporary files of a worker lie in its part of the scratch folder, also those of its children, and go with it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from capture2vr.edge.worker.scratch import Scratch

MAKE = "import tempfile; print(tempfile.mkdtemp())"


def test_temporary_files_go_with_the_workers_part(tmp_path: Path) -> None:
    before = tempfile.gettempdir(), os.environ.get("TMPDIR")
    scratch = Scratch(tmp_path)
    with scratch.claim(), scratch.with_temporary_files():
        own = Path(tempfile.mkdtemp())
        childs = Path(
            subprocess.run([sys.executable, "-c", MAKE], check=True, capture_output=True, text=True).stdout.strip()
        )
        (part,) = tmp_path.glob("worker-*")
        assert own.parent == childs.parent == part
    assert not part.exists()
    assert (tempfile.gettempdir(), os.environ.get("TMPDIR")) == before
