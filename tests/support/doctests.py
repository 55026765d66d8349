"""Run the examples in the docstrings of a module."""

from __future__ import annotations

import doctest
from types import ModuleType
from typing import Any

_OPTIONS = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL


def run_examples(module: ModuleType, **names: Any) -> int:
    """Run all examples of a module, and return their number. names: what the examples may use, beside the module's own

    Raises AssertionError with what an example printed instead.
    """
    runner = doctest.DocTestRunner(optionflags=_OPTIONS)
    said: list[str] = []
    for test in doctest.DocTestFinder().find(module, extraglobs=names):
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)
    return runner.tries
