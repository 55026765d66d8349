"""Names of an asset: changed without a new version, kept by what is published later, and read in every catalogue."""

from __future__ import annotations

import pytest

from capture2vr.order.asset_names import AssetNames
from capture2vr.storage.catalogue.change_entry import change_names
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.publication import catalogue_names
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import bundle, listed

SIGNED = Keys(signers=(ONE,))
SIGNING = PublishPolicy(SIGNED)
SUMMER = ("summer", "Größe 42")


@pytest.fixture
def store() -> MemoryStore:
    store = MemoryStore()
    publish(bundle(label="Dress", labels=["cotton"]), store, key="dress", job="one", policy=SIGNING)
    return store


def in_unity(store: MemoryStore) -> dict[str, tuple[str, ...]]:
    data = store.get(catalogue_names("default")[0].catalogue)
    return {asset.key: asset.labels for asset in parse_assets(read_json_catalogue(data))}


def test_new_names_are_read_everywhere_and_make_no_version(store: MemoryStore) -> None:
    before = read_entry(store, "dress")
    after = change_names(store, "dress", SIGNED, label=" Sunday dress ", description="Wool.\nGrey.", labels=SUMMER)
    assert after.names == AssetNames("Sunday dress", "Wool.\nGrey.", SUMMER)
    same = ("version", "manifest", "versions", "files", "proof")
    assert [after.document[each] for each in same] == [before.document[each] for each in same]
    row = listed(store, believed=SIGNED.verification_keys)["dress"]
    assert (row.label, row.labels) == ("Sunday dress", SUMMER)
    assert in_unity(store) == {"dress": tuple(sorted(SUMMER))}


def test_what_is_not_named_stays(store: MemoryStore) -> None:
    assert change_names(store, "dress", SIGNED, label="").names == AssetNames("", "", ("cotton",))
    assert change_names(store, "dress", SIGNED, labels=()).names == AssetNames("", "", ())


def test_the_same_names_write_nothing(store: MemoryStore) -> None:
    before = read_entry(store, "dress").etag
    assert change_names(store, "dress", SIGNED, label="Dress").etag == before


def test_what_a_person_changed_survives_the_rest_of_the_job_and_one_that_names_nothing(store: MemoryStore) -> None:
    names = change_names(store, "dress", SIGNED, label="Sunday dress", labels=SUMMER).names
    publish(bundle("refined", label="Dress", labels=["cotton"]), store, key="dress", job="one", policy=SIGNING)
    assert read_entry(store, "dress").names == names
    unnamed = bundle("refined", "b", label="dress")  # the key: nobody's name
    publish(unnamed, store, key="dress", job="two", policy=SIGNING)
    assert read_entry(store, "dress").names == names


def test_a_later_job_that_names_it_is_believed(store: MemoryStore) -> None:
    change_names(store, "dress", SIGNED, description="Wool.", labels=SUMMER)
    publish(bundle("refined", "b", label="Gown"), store, key="dress", job="two", policy=SIGNING)
    assert read_entry(store, "dress").names == AssetNames("Gown", "Wool.", SUMMER)


def test_a_label_that_is_another_assets_address_stays_out_of_unity(store: MemoryStore) -> None:
    publish(bundle(label="Cup"), store, key="cup", policy=SIGNING)
    change_names(store, "dress", SIGNED, labels=("captures/cup", "blue"))
    assert in_unity(store) == {"dress": ("blue",), "cup": ()}
    assert listed(store)["dress"].labels == ("captures/cup", "blue")


def test_what_is_no_name_changes_nothing(store: MemoryStore) -> None:
    before = read_entry(store, "dress")
    with pytest.raises(ValueError, match="at most 200 characters"):
        change_names(store, "dress", SIGNED, label="a" * 300)
    with pytest.raises(FileNotFoundError):
        change_names(store, "shoe", SIGNED, label="Shoe")
    assert read_entry(store, "dress") == before
