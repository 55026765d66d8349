"""The documentation site: every link leads somewhere, every route is on it, and it loads nothing from other hosts."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.test_glossary import forbidden_in
from tests.support.repository import ROOT

sys.path.insert(0, str(ROOT / "docs"))  # the site's scripts are no package
from make_site import page_on_site, site_paths, write_site

sys.path.pop(0)


@pytest.mark.slow
def test_the_site_builds_strictly_and_loads_nothing_from_other_hosts(tmp_path: Path) -> None:
    assert write_site(tmp_path / "build" / "docs", site_paths()) == []
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    command = [Path(sys.executable).with_name("zensical"), "build", "--strict", "--clean"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    site = tmp_path / "build" / "site"
    pages = {page.relative_to(site).as_posix(): page.read_text() for page in site.rglob("*.html")}
    assert {"index.html", "capture/index.html", "runbook/index.html", "bench/index.html"} <= pages.keys()
    assert 'id="post-v1-jobs"' in pages["routes/jobs/index.html"]
    routes = {page.name: page.read_text() for page in (tmp_path / "build" / "docs" / "routes").iterdir()}
    assert {name: forbidden_in(text) for name, text in routes.items() if forbidden_in(text)} == {}
    for name, text in pages.items():
        assert re.findall(r"<(?:script|img|iframe)[^>]* src=\"?(?:https?:)?//[^\s>]*", text) == [], name
        assert re.findall(r"<link[^>]*rel=\"?(?:stylesheet|preconnect|preload)[^>]*//[^>]*", text) == [], name


def test_links_are_rewritten_to_where_their_targets_lie_on_the_site() -> None:
    paths = {"docs/a.md": "a.md", "deploy/runbook.md": "runbook.md", "tests/bench/results/x.md": "bench/x.md"}
    text = "[r](../deploy/runbook.md#health) [x](../tests/bench/results/x.md) [s](../services/web/texts.json)"
    text += "\n`[no](link)`"
    rewritten, missing = page_on_site(text, "docs/a.md", paths)
    assert rewritten == "[r](runbook.md#health) [x](bench/x.md) `services/web/texts.json`\n`[no](link)`"
    assert missing == []
    back, missing = page_on_site("[a](../../../docs/a.md) [gone](gone.md)", "tests/bench/results/x.md", paths)
    assert back.startswith("[a](../a.md)")
    assert missing == ["gone.md"]
