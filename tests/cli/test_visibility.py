"""`capture2vr visibility`: set at a gateway, told in words, refused in one line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from capture2vr.cli.remote.visibility import set_visibility
from capture2vr.errors import BadInput
from capture2vr.gateway.access.caller import Scope
from tests.support.sites import Site, site_at
from tests.support.tenants import make_key, publish_for


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """Of ada a cup; the command line has her key."""
    monkeypatch.setenv("CAPTURE2VR_KEY", make_key(tmp_path / "data", "ada", {Scope.MANAGE}))
    with site_at(tmp_path) as site:
        publish_for(site.store, "ada", "cup")
        yield site


def status(site: Site, path: str) -> int:
    return httpx.get(f"{site.url}{path}", params={"tenant": "ada"}).status_code


def test_a_thing_is_opened_and_closed(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    set_visibility("cup", "unlisted", site.url, is_collection=False)
    said = capsys.readouterr().err
    assert "whoever has its address" in said
    assert f"{site.url}/view/cup?tenant=ada" in said
    assert status(site, "/v1/assets/cup") == 200
    set_visibility("cup", "inherited", site.url, is_collection=False)
    assert "as the gateway has it" in capsys.readouterr().err
    assert status(site, "/v1/assets/cup") == 401
    set_visibility("default", "public", site.url, is_collection=True)
    assert (status(site, "/v1/collections/default"), status(site, "/v1/assets/cup")) == (200, 200)


@pytest.mark.parametrize(("name", "is_collection"), [("jug", False), ("jug", True), (".x", False), (".x", True)])
def test_what_is_not_there_is_told(site: Site, name: str, is_collection: bool) -> None:
    with pytest.raises(BadInput, match=f"there is no (asset|collection) {name}|not a valid"):
        set_visibility(name, "public", site.url, is_collection=is_collection)
