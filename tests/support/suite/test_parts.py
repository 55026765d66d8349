"""All tests in parts: each file in one of them, and what has passed is not run again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.parts import files_of_tests, run_parts, seconds_in, split
from tests.support.suite.groups import group_of


@pytest.mark.parametrize("count", [1, 5, 12])
def test_every_file_is_in_one_part_and_a_group_in_one(count: int) -> None:
    files = files_of_tests()
    parts = split(files, {}, count)
    assert sorted(file for part in parts for file in part) == files
    assert Path(__file__).name in {Path(file).name for file in files}
    homes = {(group_of(file), number) for number, part in enumerate(parts) for file in part}
    assert len(homes) == len({group for group, _ in homes})


def test_parts_take_about_as_long() -> None:
    seconds = {f"tests/test_{number}.py": float(number) for number in range(1, 41)}
    lengths = [sum(seconds[file] for file in part) for part in split(seconds, seconds, 4)]
    assert max(lengths) - min(lengths) <= 2


def test_a_killed_run_goes_on_with_the_part_it_was_in(tmp_path: Path) -> None:
    state, ran = tmp_path / "cache" / "parts.json", list[int]()

    def run(number: int) -> bool:
        ran.append(number)
        if number == 3 and len(ran) == 3:
            raise KeyboardInterrupt
        return number != 2

    with pytest.raises(KeyboardInterrupt):
        run_parts([1, 2, 3, 4], run, state, "tree")
    assert run_parts([1, 2, 3, 4], run, state, "tree") == ([2], [])
    assert ran == [1, 2, 3, 2, 3, 4]
    assert run_parts([1, 2, 3, 4], run, state, "another tree") == ([2], [])
    assert ran[6:] == [1, 2, 3, 4]


def test_no_part_begins_when_the_time_is_up(tmp_path: Path) -> None:
    ran = list[int]()
    assert run_parts([3, 1, 2], lambda number: not ran.append(number), tmp_path / "parts.json", "tree", 0.0) == (
        [],
        [3, 1, 2],
    )
    assert ran == []


def test_seconds_are_read_from_the_report(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    cases = [("tests.storage.test_a", 1.25), ("tests.storage.test_a.TestMore", 0.5), ("tests.test_b", 2.0), ("", 3.0)]
    lines = "".join(f'<testcase classname="{name}" name="x" time="{seconds}"/>' for name, seconds in cases)
    report.write_text(f"<testsuites><testsuite>{lines}</testsuite></testsuites>")
    files = ["tests/storage/test_a.py", "tests/test_b.py"]
    assert seconds_in(report, files) == {"tests/storage/test_a.py": 1.8, "tests/test_b.py": 2.0}
