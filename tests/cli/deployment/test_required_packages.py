"""What an extra needs, told from the metadata of what is installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from capture2vr.cli.deployment.required_packages import required_packages

METADATA = """Metadata-Version: 2.4
Name: walnut
Version: 1
Provides-Extra: shell
Provides-Extra: kernel
Requires-Dist: httpx>=0.1
Requires-Dist: numpy>=1; extra == "shell"
Requires-Dist: no-such-package>=2; extra == "shell"
Requires-Dist: scipy>=99; extra == "shell"
Requires-Dist: of-another-system; sys_platform == "none" and extra == "shell"
Requires-Dist: walnut[kernel]; extra == "shell"
Requires-Dist: pillow; extra == "kernel"
"""


@pytest.fixture
def walnut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed distribution of that name, without code."""
    folder = tmp_path / "walnut-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(METADATA)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.usefixtures("walnut")
def test_what_an_extra_adds_is_found_and_judged() -> None:
    needed = {each.name: each for each in required_packages("walnut", "shell")}
    assert list(needed) == ["no-such-package", "numpy", "pillow", "scipy", "walnut"]
    assert {name for name, each in needed.items() if each.suits} == {"numpy", "pillow", "walnut"}
    assert str(needed["numpy"]) == f"numpy {version('numpy')}"
    assert str(needed["no-such-package"]) == "no-such-package"
    assert str(needed["scipy"]) == f"scipy>=99, not {version('scipy')}"


@pytest.mark.usefixtures("walnut")
def test_an_extra_that_there_is_not_adds_nothing() -> None:
    assert required_packages("walnut", "leaf") == []


def test_a_distribution_that_is_not_installed_is_an_error() -> None:
    with pytest.raises(PackageNotFoundError):
        required_packages("no-such-package", "shell")
