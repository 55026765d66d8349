"""Answers in the reader's language, and the codes that are the same in each."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.languages import LANGUAGES, preferred_language
from tests.support.in_process_gateway import gateway, memory


@pytest.mark.parametrize(
    ("accept", "language"),
    [
        ("", "en"),
        ("de", "de"),
        ("de-AT,de;q=0.9,en;q=0.8", "de"),
        ("en-GB,en;q=0.9,de;q=0.8", "en"),
        ("fr-FR,de;q=0.5,en;q=0.7", "en"),
        ("fr, DE;q=0.3", "de"),
        ("de;q=0.4,en", "en"),
        ("*", "en"),
        ("de;q=x", "de"),
    ],
)
def test_the_language_is_the_one_that_the_browser_wants_most(accept: str, language: str) -> None:
    assert preferred_language(accept) == language


@given(st.text())
def test_any_header_leads_to_a_language(accept: str) -> None:
    assert preferred_language(accept) in LANGUAGES


@pytest.fixture
async def client(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    async with gateway(tmp_path / "gw", memory()) as found:
        yield found


CODE = {"code": "no_job", "values": {"job": "job_x"}}


async def test_a_problem_is_told_in_the_language_of_the_request(client: httpx.AsyncClient) -> None:
    german = await client.get("/v1/jobs/job_x", headers={"Accept-Language": "de-AT, en;q=0.5"})
    assert german.json()["detail"] == "einen Auftrag job_x gibt es nicht"
    assert german.json()["detail_i18n"] == CODE
    assert (german.headers["content-language"], german.headers["vary"]) == ("de", "Accept-Language")


async def test_programs_that_name_no_language_get_english_and_the_same_codes(client: httpx.AsyncClient) -> None:
    english = await client.get("/v1/jobs/job_x")
    assert english.json()["detail"] == "there is no job job_x"
    assert english.json()["detail_i18n"] == CODE
    assert (english.headers["content-language"], english.headers["vary"]) == ("en", "Accept-Language")


async def test_an_answer_without_sentences_has_no_language(client: httpx.AsyncClient) -> None:
    jobs = await client.get("/v1/jobs", headers={"Accept-Language": "de"})
    assert "content-language" not in jobs.headers


async def test_a_refused_upload_says_why_in_german(client: httpx.AsyncClient) -> None:
    """Its check ran in another process, which sent the codes along."""
    files = {"files": ("bild.png", b"GIF89a" * 99, "image/png")}
    refused = await client.post("/v1/captures", files=files, headers={"Accept-Language": "de"})
    assert refused.status_code == 422
    assert refused.json()["detail"] == "das ist kein lesbares Bild, obwohl der Name es sagt"
    assert refused.json()["file"] == "bild.png"
    assert refused.json()["detail_i18n"] == {"code": "not_image_can_be_read_although", "values": {}}
