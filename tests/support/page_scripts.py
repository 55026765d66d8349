"""Modules of the pages that need no page: what they compute is asked of Node, which starts sooner than a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from tests.conftest import missing
from tests.support.repository import ROOT


class PageScripts:
    """A Node process in which `import('/web/…')` loads a page's module."""

    def __init__(self, asked: IO[str], answered: IO[str]) -> None:
        self._asked, self._answered = asked, answered

    def evaluate(self, source: str, argument: object = None) -> Any:
        """Call a JavaScript function, given as its source, with an argument, as Playwright's pages do."""
        self._asked.write(json.dumps({"source": source, "argument": argument}) + "\n")
        self._asked.flush()
        answer = json.loads(self._answered.readline())
        assert "error" not in answer, answer["error"]
        return answer.get("value")


@contextmanager
def running() -> Iterator[PageScripts]:
    """The process, until the block ends."""
    node = shutil.which("node")
    if node is None:
        missing("node, to run modules of the pages")
    command = [str(node), str(Path(__file__).with_suffix(".mjs")), str(ROOT / "services" / "web")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield PageScripts(process.stdin, process.stdout)
        process.stdin.close()
