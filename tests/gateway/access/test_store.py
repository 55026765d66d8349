"""Tenants, keys and pairings on disk: no secret is stored, a pairing is claimed once, keys stay with their tenants."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from capture2vr.gateway.access import store as module
from capture2vr.gateway.access.api_key import KEY_PATTERN, hash_of, new_secret
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import metadata, open_engine

READ = (Scope.READ,)


@pytest.fixture
def store(url: str) -> Iterator[AccessStore]:
    engine = open_engine(url)
    made = AccessStore(engine)
    made.ensure_tenant("ada", "Ada")
    made.ensure_tenant("bob")
    yield made
    engine.dispose()


def test_a_key_comes_back_in_every_field(store: AccessStore) -> None:
    key, secret = store.create_key("ada", (Scope.READ, Scope.CAPTURE), label="phone", expires=5e9)
    assert KEY_PATTERN.fullmatch(secret)
    assert secret.startswith("c2v_ada_")
    assert store.key_by_hash(hash_of(secret)) == store.key(key.id) == key
    assert key.scopes == {Scope.READ, Scope.CAPTURE}


def test_a_key_of_the_settings_is_stored_once(store: AccessStore) -> None:
    secret = new_secret("eve")
    made = store.ensure_key(secret, "first")
    assert (made.tenant, made.label, made.scopes) == ("eve", "first", frozenset(Scope))
    assert store.key_by_hash(hash_of(secret)) == store.ensure_key(secret, "second") == made
    store.revoke_key(made.id, None)
    assert store.ensure_key(secret, "first").refusal(time.time()) == "revoked"
    with ThreadPoolExecutor(8) as pool:
        other = new_secret("ada")
        assert len({each.id for each in pool.map(lambda _: store.ensure_key(other, ""), range(8))}) == 1
    with pytest.raises(ValueError, match="this is no access key"):
        store.ensure_key("c2v_eve_short", "")


def test_a_secret_is_stored_nowhere(store: AccessStore, url: str) -> None:
    _, secret = store.create_key("ada", READ)
    _, token = store.create_pairing("ada", READ, label="", key_expires=None)
    engine = open_engine(url)
    with engine.begin() as db:
        rows = [row for table in metadata.sorted_tables for row in db.execute(sa.select(table))]
    engine.dispose()
    assert not [row for row in rows if secret in str(row) or token in str(row)]


def test_keys_are_of_their_tenant(store: AccessStore) -> None:
    keys = {tenant: store.create_key(tenant, READ)[0] for tenant in ("ada", "bob")}
    assert store.list_keys("ada", limit=9) == [keys["ada"]]
    assert {key.id for key in store.list_keys(None, limit=9)} == {key.id for key in keys.values()}
    assert store.revoke_key(keys["bob"].id, "ada") is None
    found = store.key(keys["bob"].id)
    assert found is not None
    assert found.revoked is None
    revoked = store.revoke_key(keys["bob"].id, "bob")
    assert revoked is not None
    assert revoked.refusal(time.time()) == "revoked"
    assert store.revoke_key(keys["bob"].id, "bob") == revoked, "a second time changes nothing"


def test_an_unknown_tenant_gets_no_key(store: AccessStore) -> None:
    with pytest.raises(sa.exc.IntegrityError):
        store.create_key("nobody", READ)


def test_an_earlier_end_stays(store: AccessStore) -> None:
    key, _ = store.create_key("ada", READ, expires=1_000.0)
    store.expire_key(key.id, "ada", 2_000.0)
    assert store.key(key.id) == key
    store.expire_key(key.id, "bob", 500.0)
    assert store.key(key.id) == key
    store.expire_key(key.id, "ada", 500.0)
    found = store.key(key.id)
    assert found is not None
    assert found.expires == 500.0


def test_the_last_use_only_moves_on(store: AccessStore) -> None:
    key, _ = store.create_key("ada", READ)
    for at in (200.0, 100.0):
        store.note_use({key.id: at})
    found = store.key(key.id)
    assert found is not None
    assert found.last_used == 200.0


@pytest.mark.parametrize("by", ["token", "code"])
def test_a_pairing_is_claimed_by_one_of_many(store: AccessStore, by: str) -> None:
    pairing, token = store.create_pairing("ada", READ, label="headset", key_expires=7e9)
    shown = {"token": token} if by == "token" else {"code": pairing.code}
    with ThreadPoolExecutor(6) as pool:
        claims = [claim for claim in pool.map(lambda _: store.claim_pairing(**shown), range(6)) if claim]
    ((key, secret),) = claims
    assert (key.tenant, key.label, key.scopes, key.expires) == ("ada", "headset", {Scope.READ}, 7e9)
    assert store.key_by_hash(hash_of(secret)) == key
    claimed = store.pairing(pairing.id, "ada")
    assert claimed is not None
    assert claimed.key == key.id
    assert store.pairing(pairing.id, "bob") is None


def test_a_pairing_ends(store: AccessStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PAIRING_S", -1.0)
    pairing, token = store.create_pairing("ada", READ, label="", key_expires=None)
    assert store.claim_pairing(token=token) is None
    assert store.claim_pairing(code=pairing.code) is None


def test_open_pairings_have_codes_of_their_own(store: AccessStore, monkeypatch: pytest.MonkeyPatch) -> None:
    digits = iter([1, 1, 1, 2])
    monkeypatch.setattr(module.random, "randbelow", lambda _: next(digits))
    codes = [store.create_pairing("ada", READ, label="", key_expires=None)[0].code for _ in range(2)]
    assert codes == ["0000000001", "0000000002"]


def test_gateways_share_a_secret(url: str, tmp_path: Path) -> None:
    engine = open_engine(url)
    with ThreadPoolExecutor(6) as pool:
        found = set(pool.map(lambda _: AccessStore(engine).secret("session"), range(6)))
    engine.dispose()
    assert len(found) == 1
    assert len(found.pop()) == 64


def test_tenants_are_listed_in_pages(store: AccessStore) -> None:
    assert [tenant.name for tenant in store.list_tenants(limit=2)] == ["ada", "bob"]
    assert [tenant.name for tenant in store.list_tenants(limit=2, after="bob")] == ["default"]
    assert not store.ensure_tenant("ada", "again")
    found = store.tenant("ada")
    assert found is not None
    assert found.label == "Ada"
