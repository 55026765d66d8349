"""The attacks of docs/security.md: each has a test that exists, and the cheap ones are made on the running product."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.bench.load.attack import Product, measure, started
from tests.bench.load.attacks import ATTACKS, Attack
from tests.support.repository import ROOT

PAGE = ROOT / "docs" / "security.md"
_ROW = re.compile(r"^\| (?P<attack>.+?) \| (?P<now>.+?) \| (?P<tests>.+?) \|$", re.MULTILINE)
_TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def rows() -> dict[str, list[tuple[str, str]]]:
    """File and name of the tests of each attack."""
    found = {row["attack"].strip(): _TEST.findall(row["tests"]) for row in _ROW.finditer(PAGE.read_text())}
    return {attack: tests for attack, tests in found.items() if attack != "attack" and not attack.startswith("-")}


@pytest.mark.parametrize("attack", rows())
def test_each_attack_has_a_test(attack: str) -> None:
    tests = rows()[attack]
    assert tests
    for file, name in tests:
        tree = ast.parse((ROOT / file).read_text())
        assert name in {
            each.name for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
        }


@pytest.fixture(scope="module")
def product() -> Iterator[Product]:
    with started() as running:
        yield running


@pytest.mark.slow
@pytest.mark.essential
@pytest.mark.parametrize("attack", [each for each in ATTACKS if each.cheap], ids=lambda each: each.name)
def test_an_attack_of_the_bench_changes_nothing_for_others(attack: Attack, product: Product) -> None:
    """Those that cost little; `python -m tests.bench attack` has all, and what they may cost."""
    found = measure(product, attack)
    assert not found.fault, found.answers
