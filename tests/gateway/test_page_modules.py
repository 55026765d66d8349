"""All modules of a page are named in the page itself, and none that comes later; an id names one element."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

import pytest

from capture2vr.gateway import page_texts
from capture2vr.gateway.page_modules import name_modules, static_imports

WEB = page_texts.WEB.resolve()  # the package may be a link, and imports between modules are resolved
_LINK = re.compile(r'<link rel="modulepreload" fetchpriority="low" href="/web/([^"]+)">')
_SOURCE = re.compile(r"""^\s*(?:import|export)\b[^;'(]*\bfrom '(\.[^']+)';""", re.MULTILINE)
_PAGES = sorted(WEB.rglob("*.html"))


def write(folder: Path, **modules: str) -> None:
    for name, text in modules.items():
        (folder / f"{name}.js").write_text(text)


def names(modules: list[Path]) -> list[str]:
    return [module.stem for module in modules]


def test_the_nearest_come_first_and_each_once(tmp_path: Path) -> None:
    write(
        tmp_path,
        entry="import { a,\n  b } from './one.js';\nimport './two.js';\nconst text = \"import './text.js'\";\n",
        one="export * from \"./three.js\";\nimport * as all from './two.js';\n",
        two="export const from = './nothing.js';\nimport('./later.js');\n// import './comment.js'\n",
        three="import { back } from './entry.js';import x from 'bare';\n",
    )
    assert names(static_imports(tmp_path / "entry.js")) == ["one", "two", "three"]


def test_minified_modules_are_read_too(tmp_path: Path) -> None:
    write(
        tmp_path,
        entry=(
            '/* licence */import{a as b}from"./one.js";import{c}from"./two.js";'
            'export*from"./three.js";import("./later.js")'
        ),
        one="",
        two="",
        three="",
    )
    assert names(static_imports(tmp_path / "entry.js")) == ["one", "two", "three"]


def test_a_module_that_was_changed_is_read_again(tmp_path: Path) -> None:
    write(tmp_path, entry="import './one.js';\n", one="", second="")
    assert names(static_imports(tmp_path / "entry.js")) == ["one"]
    write(tmp_path, entry="import './second.js';\n")
    assert names(static_imports(tmp_path / "entry.js")) == ["second"]


def test_an_import_of_nothing_is_an_error(tmp_path: Path) -> None:
    write(tmp_path, entry="import './nowhere.js';\n")
    with pytest.raises(FileNotFoundError, match=r"nowhere\.js"):
        static_imports(tmp_path / "entry.js")


def test_what_comes_later_is_listed_without_what_is_there(tmp_path: Path) -> None:
    write(tmp_path, entry="import './both.js';\n", both="", then="import './both.js';\nimport './more.js';\n", more="")
    page = name_modules('<script type="module" src="/web/entry.js" data-later="/web/then.js"></script>', tmp_path)
    assert _LINK.findall(page) == ["both.js"]
    listed = re.search(r'<script id="later" type="application/json">(.*?)</script>', page)
    assert listed
    assert json.loads(listed[1]) == ["/web/then.js", "/web/more.js"]
    assert '<script type="module" src="/web/entry.js"></script>' in page


def test_pages_are_found_through_a_link_to_their_release(tmp_path: Path) -> None:
    (tmp_path / "release").mkdir()
    write(tmp_path / "release", entry="import './one.js';\n", one="", then="import './one.js';\n")
    (tmp_path / "current").symlink_to("release")
    html = '<script type="module" src="/web/entry.js" data-later="/web/then.js"></script>'
    assert name_modules(html, tmp_path / "current") == name_modules(html, tmp_path / "release")


@pytest.mark.parametrize("page", _PAGES, ids=[page.stem for page in _PAGES])
def test_each_page_names_the_modules_of_its_script(page: Path) -> None:
    html = page.read_text()
    entry = re.search(r'<script type="module" src="/web/([^"]+)"', html)
    assert entry, "each page has one script"
    named = {WEB / address for address in _LINK.findall(name_modules(html, WEB))} | {WEB / entry[1]}
    for module in named - set((WEB / "vendor").iterdir()):
        for source in _SOURCE.findall(module.read_text()):
            assert (module.parent / source).resolve() in named, f"{module.name} imports {source}"


@pytest.mark.parametrize("page", _PAGES, ids=[page.stem for page in _PAGES])
def test_an_id_of_a_page_names_one_element(page: Path) -> None:
    """A script finds the first of two elements of one id, and says there what belongs to the other one."""
    ids = Counter(re.findall(r'\sid="([^"]+)"', page.read_text()))
    assert [name for name, count in ids.items() if count > 1] == []
