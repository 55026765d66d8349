"""Visibility: what lists show, what stays when versions come, and what nobody finds of a list that was private."""

from __future__ import annotations

import base64
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.catalogue.change_entry import remove, restore, set_asset_visibility
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.signing import Keys, Signature, check_signatures
from capture2vr.storage.catalogue.update import rebuild, set_collection_visibility
from capture2vr.storage.catalogue.visibility import Visibility, effective, lists, parse_visibility
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import list_all
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.publication import catalogue_names
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import bundle, listed

SIGNED = Keys(signers=(ONE,))
SIGNING = PublishPolicy(SIGNED)
PRIVATE, UNLISTED, PUBLIC = Visibility
SOME = st.sampled_from([None, *Visibility])


@pytest.fixture
def store() -> MemoryStore:
    """A dress without a visibility of its own, a private letter, an unlisted draft, and a public cup."""
    store = MemoryStore()
    for key, own in {"dress": None, "letter": PRIVATE, "draft": UNLISTED, "cup": PUBLIC}.items():
        publish(bundle(label=key), store, key=key, policy=SIGNING, visibility=own)
    return store


def in_unity(store: MemoryStore, collection: str = "default") -> set[str]:
    data = store.get(catalogue_names(collection)[0].catalogue)
    return {asset.key for asset in parse_assets(read_json_catalogue(data))}


def test_a_tenants_own_list_has_everything_and_one_for_others_what_is_public(store: MemoryStore) -> None:
    everything = {"dress", "letter", "draft", "cup"}
    assert set(listed(store, believed=SIGNED.verification_keys)) == in_unity(store) == everything
    for visibility, keys in ((PUBLIC, {"dress", "cup"}), (UNLISTED, {"dress", "cup"}), (PRIVATE, everything)):
        index = set_collection_visibility(store, "default", visibility, SIGNED)
        assert index.visibility is visibility
        assert read_root(store, "default", SIGNED.verification_keys) == index
        assert set(listed(store)) == in_unity(store) == keys
    assert set_collection_visibility(store, "default", PRIVATE, SIGNED) == index, "nothing has changed"


def test_an_asset_leaves_a_public_list_and_comes_back(store: MemoryStore) -> None:
    set_collection_visibility(store, "default", PUBLIC, SIGNED)
    for own in (PRIVATE, UNLISTED):
        assert set_asset_visibility(store, "cup", own, SIGNED).visibility is own
        assert set(listed(store)) == in_unity(store) == {"dress"}
        remove(store, "cup", SIGNED)
        restore(store, "cup", SIGNED)
        publish(bundle(content=own), store, key="cup", policy=SIGNING)
        assert set(listed(store)) == in_unity(store) == {"dress"}, "a new version tells nobody"
        assert rebuild(store, "default", SIGNED).visibility is PUBLIC
        assert set(listed(store)) == {"dress"}
    set_asset_visibility(store, "dress", PRIVATE, SIGNED)
    assert listed(store) == {}
    set_asset_visibility(store, "cup", None, SIGNED)
    assert set(listed(store)) == in_unity(store) == {"cup"}


def test_nothing_leads_from_a_public_list_to_what_it_was_before(store: MemoryStore) -> None:
    set_collection_visibility(store, "default", PUBLIC, SIGNED)
    assert read_root(store, "default").retired == ()
    objects = b"".join(store.get(head.name) for head in list_all(store, "collections/"))
    assert b"cup" in objects
    assert b"letter" not in objects
    assert b"draft" not in objects


def test_nothing_leads_from_a_public_list_to_what_has_left_it(store: MemoryStore) -> None:
    set_collection_visibility(store, "default", PUBLIC, SIGNED)
    for number, own in enumerate((PRIVATE, UNLISTED)):
        publish(bundle(content=str(number), label="The bedroom"), store, key="room", policy=SIGNING, visibility=PUBLIC)
        set_asset_visibility(store, "room", own, SIGNED)
        assert b"bedroom" not in b"".join(store.get(head.name) for head in list_all(store, "collections/default/shard"))
        assert set(listed(store, believed=SIGNED.verification_keys)) == {"dress", "cup"}
        assert read_root(store, "default").retired == ()


def test_a_job_decides_once_and_its_owner_ever_after() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress", job="one", visibility=PRIVATE)
    set_asset_visibility(store, "dress", PUBLIC)
    publish(bundle("refined"), store, key="dress", job="one", visibility=PRIVATE)
    assert (read_entry(store, "dress").version, read_entry(store, "dress").visibility) == (2, PUBLIC)
    publish(bundle(content="b"), store, key="dress", job="two", visibility=UNLISTED)
    assert read_entry(store, "dress").visibility is UNLISTED
    publish(bundle(content="c"), store, key="dress", job="three")
    assert read_entry(store, "dress").visibility is UNLISTED


def test_each_version_is_signed_by_itself(store: MemoryStore) -> None:
    for content in ("a", "b"):
        publish(bundle(content=content), store, key="dress", policy=SIGNING)
        document = read_entry(store, "dress").document
        proof = document["proof"]
        signatures: list[Signature] = proof["signatures"]
        check_signatures("x", proof["signed"].encode(), signatures, SIGNED.verification_keys)
        facts = json.loads(proof["signed"])
        manifest = document["manifest"]["sha256"]
        assert facts == {"schema": 1, "asset": "dress", "version": document["version"], "manifest": manifest}
    assert len(base64.b64decode(signatures[0]["ed25519"])) == 64
    publish(bundle(), unsigned := MemoryStore(), key="dress")
    assert "proof" not in read_entry(unsigned, "dress").document


def test_what_is_not_there_has_no_visibility(store: MemoryStore) -> None:
    with pytest.raises(FileNotFoundError):
        set_asset_visibility(store, "nothing", PUBLIC)
    with pytest.raises(FileNotFoundError):
        set_collection_visibility(store, "nothing", PUBLIC)
    with pytest.raises(ValueError, match="not a valid asset key"):
        set_asset_visibility(store, "../x", PUBLIC)


@given(own=SOME, of_collections=st.lists(SOME))
def test_an_assets_own_visibility_holds_else_the_widest(
    own: Visibility | None, of_collections: list[Visibility | None]
) -> None:
    found = effective(own, of_collections)
    if own is not None:
        assert found is own
    elif PUBLIC in of_collections:
        assert found is PUBLIC
    else:
        assert found in of_collections or (found is None and set(of_collections) <= {None})
    assert not (lists(PUBLIC, own) and own is PRIVATE)


def test_what_is_not_understood_is_private() -> None:
    assert [parse_visibility(each) for each in (None, "", "public", "friends", 7)] == [
        None,
        None,
        PUBLIC,
        PRIVATE,
        PRIVATE,
    ]
