"""Pages in English and German: which language a browser gets, and that no text of a page is without a translation."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.page_texts import WEB, german_texts, one_line, texts_of_scripts, translate_page
from tests.support.html_texts import Texts
from tests.support.in_process_gateway import gateway, memory

PAGES = sorted(path for path in WEB.glob("*/*.html") if path.parent.name != "admin")
SCRIPTS = sorted(path for path in WEB.glob("*/*.js") if path.parent.name not in {"admin", "vendor"})
ONLY_NAMES = {"capture2vr", "123 456 7890", "c2v_…"}  # the same in every language
_CALL = re.compile(r"\bt\(\s*'((?:[^'\\]|\\.)*)'")
_PLACE = re.compile(r"\{\w+\}")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_text_of_a_page_is_german_in_the_german_page(page: Path) -> None:
    english = page.read_text(encoding="utf-8")
    german = translate_page(english, "de")
    texts = Texts(german).found
    assert len(texts) == len(Texts(english).found) > 5
    table = german_texts()
    known = ONLY_NAMES | set(table.values())
    assert [text for text in texts if not any(text in value for value in known)] == []
    assert '<html lang="de"' in german


def test_every_sentence_of_the_scripts_has_a_translation_and_no_translation_is_without_use() -> None:
    said = {text.replace("\\'", "'") for path in SCRIPTS for text in _CALL.findall(path.read_text(encoding="utf-8"))}
    table = german_texts()
    assert said - set(table) == set()
    pages = " ".join(one_line(path.read_text(encoding="utf-8")) for path in PAGES)
    assert [text for text in set(table) - said if text not in pages] == []


def test_a_translation_has_the_values_of_its_sentence() -> None:
    table = german_texts()
    assert len(table) > 300
    for text, translation in table.items():
        assert sorted(_PLACE.findall(text)) == sorted(_PLACE.findall(translation)), text
        assert re.findall("<[^>]*>", text) == re.findall("<[^>]*>", translation), text


@pytest.fixture
async def client(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    async with gateway(tmp_path / "gw", memory()) as found:
        yield found


async def test_a_german_browser_gets_the_german_page_with_the_table_for_its_scripts(client: httpx.AsyncClient) -> None:
    page = await client.get("/", headers={"Accept-Language": "de-DE,de;q=0.9,en;q=0.8"})
    assert page.headers["content-language"] == "de"
    assert "Accept-Language" in page.headers["vary"]
    assert "<h1>Ein Ding aufnehmen</h1>" in page.text
    found = re.search(r'<script id="texts" type="application/json">(.*?)</script>', page.text, re.DOTALL)
    assert found is not None
    table = json.loads(found[1])
    assert table == texts_of_scripts(page.text)
    assert 100 < len(table) < len(german_texts()), "only what this page's scripts say"
    assert table["Waiting for a worker"]


@pytest.mark.slow
@pytest.mark.parametrize("path", ["/", "/view/any", "/browse/default", "/edit/any", "/login", "/pair"])
async def test_a_german_page_is_small(client: httpx.AsyncClient, path: str) -> None:
    headers = {"Accept-Language": "de", "Accept-Encoding": "gzip"}
    async with client.stream("GET", path, headers=headers) as page:
        assert sum([len(chunk) async for chunk in page.aiter_raw()]) <= 12_000
        assert page.headers["content-encoding"] == "gzip"


async def test_scripts_get_what_is_stored_in_german_and_keep_it_for_ever(client: httpx.AsyncClient) -> None:
    page = await client.get("/", headers={"Accept-Language": "de"})
    found = re.search('<html lang="de" data-sentences="([^"]+)">', page.text)
    assert found is not None
    sentences = await client.get(found[1])
    assert sentences.json()["has_no_points"] == "hat keine Punkte"
    assert "immutable" in sentences.headers["cache-control"]
    for unknown in ("de-0000000000000000", "en-0000000000000000", "fr", "de"):
        assert (await client.get(f"/web/sentences/{unknown}.json")).status_code == 404
    shell = await client.get("/web/shell.json", headers={"Accept-Language": "de"})
    assert found[1] in shell.json()["files"], "or the page would be English without the server"
    english = await client.get("/web/shell.json")
    assert found[1] not in english.json()["files"]
    assert english.json()["version"] != shell.json()["version"]


async def test_others_get_the_english_page_and_operators_pages_are_english(client: httpx.AsyncClient) -> None:
    page = await client.get("/", headers={"Accept-Language": "fr"})
    assert page.headers["content-language"] == "en"
    assert not re.search('id="texts"|data-sentences', page.text)
    assert "<h1>Capture an object</h1>" in page.text
    operators = await client.get("/admin", headers={"Accept-Language": "de"})
    assert operators.headers["content-language"] == "en"
