"""`pull` of what is private: with a key, by a share link of an asset or a collection, and not without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.cli.remote.pull import pull_asset
from capture2vr.errors import BadInput
from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.bundles import bundle
from tests.support.sites import Site, site_at
from tests.support.tenants import bearer, make_key, publish_for

Pull = Callable[..., dict[str, object]]


@pytest.fixture
def secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Ada's key."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("CAPTURE2VR_KEY", raising=False)
    return make_key(tmp_path / "data", "ada", ALL_SCOPES - {Scope.OPERATE})


@pytest.fixture
def site(tmp_path: Path, secret: str) -> Iterator[Site]:
    """Ada has a signed shoe."""
    generate_key(tmp_path / "key")
    keys = Keys((read_signer(tmp_path / "key"),))
    with site_at(tmp_path, keys) as site:
        publish_for(site.store, "ada", "shoe", policy=PublishPolicy(keys))
        yield site


@pytest.fixture
def pull(site: Site, tmp_path: Path) -> Pull:
    def call(key: str = "", **options: Any) -> dict[str, object]:
        trusted = [tmp_path / "key.pub"]
        out, cache = tmp_path / "out", tmp_path / "cache"
        return pull_asset(key, out, site.url, trusted=trusted, cache=cache, **options)

    return call


def share(site: Site, secret: str, **body: Any) -> dict[str, Any]:
    answer = httpx.post(f"{site.url}/v1/shares", json=body, headers=bearer(secret))
    return dict(answer.raise_for_status().json())


def test_with_a_key_and_not_without(pull: Pull, secret: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="needs an access key"):
        pull("shoe")
    monkeypatch.setenv("CAPTURE2VR_KEY", secret)
    assert pull("shoe")["key"] == "shoe"
    assert (tmp_path / "out" / "lod0.glb").exists()


def test_by_a_link_until_it_is_revoked(
    pull: Pull, site: Site, secret: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made = share(site, secret, asset="shoe")
    assert pull(share=made["url"])["key"] == "shoe"
    assert "asset shoe version 1: signature, version, sizes and hashes are correct" in capsys.readouterr().err
    assert (tmp_path / "out" / "lod0.glb").exists()
    with pytest.raises(BadInput, match="shares the asset shoe, not boot"):
        pull("boot", share=made["url"])
    httpx.delete(f"{site.url}/v1/shares/{made['id']}", headers=bearer(secret)).raise_for_status()
    with pytest.raises(BadInput, match="the link was taken back"):
        pull(share=made["url"])


@pytest.mark.slow
def test_by_a_collections_link_with_a_password(
    pull: Pull, site: Site, secret: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = share(site, secret, collection="default", password="open sesame")["url"]
    with pytest.raises(BadInput, match="shared with a password"):
        pull("shoe", share=link)
    monkeypatch.setenv("CAPTURE2VR_SHARE_PASSWORD", "open sesame")
    with pytest.raises(BadInput, match="name one of its assets"):
        pull(share=link)
    assert pull("shoe", share=link)["key"] == "shoe"


def test_an_older_version_than_was_seen_is_refused(pull: Pull, site: Site, secret: str) -> None:
    link = share(site, secret, asset="shoe")["url"]
    entry = site.store.get("tenants/ada/catalog/shoe.json")
    publish(bundle(content="two"), store_of_tenant(site.store, "ada"), key="shoe", policy=PublishPolicy(site.keys))
    pull(share=link)
    site.store.put("tenants/ada/catalog/shoe.json", entry, content_type="application/json")
    with pytest.raises(BadInput, match="older than 2"):
        pull(share=link)


@pytest.mark.parametrize(
    "link", ["nonsense", "https://vr.example/view/shoe", "ftp://vr.example/s/x", "https://a/s/", "https://[a/s/shr_1"]
)
def test_what_is_no_link_is_told(pull: Pull, link: str) -> None:
    with pytest.raises(BadInput, match="is not a share link"):
        pull(share=link)
