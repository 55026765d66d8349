"""Unity's catalogues: what is written is read again, by our readers and by another program."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.storage.unity.listing import PREFAB_PROVIDER, Listing
from capture2vr.storage.unity.locations import build_listing, parse_assets
from capture2vr.storage.unity.nouns import BASE_URL, Asset, Catalogue
from capture2vr.storage.unity.publication import catalogue_files, catalogue_hash, catalogue_names
from tests.referees.addressables.reader import AddressablesTools
from tests.referees.addressables.reader import addressables_tools as addressables_tools
from tests.support.clients.unity_catalogues import (
    FORMS,
    asset,
    catalogue,
    catalogues,
    in_order,
    lod,
    many,
    reader,
    written,
)

every_form = pytest.mark.parametrize("form", FORMS)


@pytest.mark.slow
@every_form
@given(made=catalogues)
@settings(max_examples=40)
def test_what_is_written_is_read(form: int, made: Catalogue) -> None:
    listing = reader(form)(written(made, form))
    assert (listing.form, listing.locator_id) == (form, made.locator_id)
    assert replace(listing, form=0) == build_listing(made)
    assert parse_assets(listing) == in_order(made.assets)


@every_form
@given(made=catalogues, random=st.randoms(use_true_random=False))
@settings(max_examples=15)
def test_the_order_in_which_assets_come_does_not_matter(form: int, made: Catalogue, random: Any) -> None:
    shuffled = [replace(each, labels=each.labels[::-1], files=each.files[::-1]) for each in made.assets]
    random.shuffle(shuffled)
    assert written(replace(made, assets=tuple(shuffled)), form) == written(made, form)


@every_form
def test_every_change_shows_in_the_hash(form: int) -> None:
    dress = asset("dress", "clothes")
    changed = [
        replace(dress, key="shirt"),
        replace(dress, version=2),
        replace(dress, labels=("cloth",)),
        replace(dress, files=dress.files[:2]),
        replace(dress, files=(*dress.files[:2], replace(dress.files[2], size=5))),
    ]
    hashes = {catalogue_hash(written(catalogue(each), form)) for each in (dress, *changed)}
    assert len(hashes) == 6
    assert all(len(each) == 32 for each in hashes)


@every_form
@settings(max_examples=20)
@given(made=catalogues, later=st.integers(1, 9))
def test_no_two_versions_of_an_asset_have_an_id_in_common(form: int, made: Catalogue, later: int) -> None:
    """Addressables tells what it has loaded by internal id alone."""
    newer = replace(made, assets=tuple(replace(each, version=each.version + later) for each in made.assets))
    ids = [_ids(reader(form)(written(each, form))) for each in (made, newer)]
    keys = {location.key for location in build_listing(made).locations if location.provider == PREFAB_PROVIDER.name}
    assert ids[0].keys() == ids[1].keys()
    assert all((ids[0][key] != ids[1][key]) == (key in keys) for key in ids[0])
    assert all(len(set(each.values())) == len(each) for each in ids)


def _ids(listing: Listing) -> dict[str, str]:
    return {location.key: location.internal_id for location in listing.locations}


@every_form
def test_another_base_url_is_not_taken_for_ours(form: int) -> None:
    made = replace(catalogue(asset()), base_url="https://cdn.example/v1/files")
    listing = reader(form)(written(made, form))
    assert listing.locations[0].internal_id.startswith("https://cdn.example/v1/files/assets/")
    assert parse_assets(listing, base_url=made.base_url) == made.assets
    with pytest.raises(ValueError, match=r"not written by capture2vr|not a valid object name|does not end"):
        parse_assets(listing)


def test_names_are_unitys_and_hashes_come_last() -> None:
    names = catalogue_names("museum")
    assert [each.catalogue for each in names] == [
        "collections/museum/unity/catalog.json",
        "collections/museum/unity/catalog_v1.bin",
        "collections/museum/unity/catalog_v2.bin",
        "collections/museum/unity/catalog_v3.bin",
    ]
    for each in names:
        assert each.hash == str(Path(each.catalogue).with_suffix(".hash"))
    assert len({each.hash for each in names}) == 4

    files = catalogue_files(catalogue(asset()), "museum")
    order = [name for name, _ in files]
    contents = dict(files)
    assert sorted(order) == sorted(name for each in names for name in (each.catalogue, each.hash))
    for each in names:
        assert order.index(each.catalogue) < order.index(each.hash)
        assert contents[each.hash] == catalogue_hash(contents[each.catalogue])
        assert reader(each.form)(contents[each.catalogue]).form == each.form


@pytest.mark.parametrize("collection", ["", "..", "a b", "../x"])
def test_a_collection_must_be_a_name(collection: str) -> None:
    with pytest.raises(ValueError, match="not a valid object name"):
        catalogue_names(collection)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (replace(asset(), key=""), "not a key for Unity"),
        (replace(asset(), key="{Application.version}"), "not a key for Unity"),
        (replace(asset(), key="\ud800"), "not valid Unicode"),
        (replace(asset(), version=0), "version 0"),
        (replace(asset(), version=10**9), "version 1000000000"),
        (replace(asset(), labels=("a", "a")), "label 'a' twice"),
        (replace(asset(), labels=("",)), "empty label"),
        (replace(asset(), labels=("\udfff",)), "not valid Unicode"),
        (replace(asset(), labels=tuple(str(number) for number in range(101))), "101 labels"),
        (replace(asset(), labels=("captures/dress",)), "choose another"),
        (replace(asset(), files=()), "no files"),
        (replace(asset(), files=(lod("a"), lod("b"))), "level 0 twice"),
        (replace(asset(), files=(replace(lod("a"), sha256="A" * 64),)), "not a SHA-256"),
        (replace(asset(), files=(replace(lod("a"), url="assets/a/lod0.glb"),)), "does not end in"),
        (replace(asset(), files=(replace(lod("a"), url="/" + lod("a").url),)), "not a valid object name"),
        (replace(asset(), files=(replace(lod("a"), size=0),)), "out of range"),
        (replace(asset(), files=(replace(lod("a"), size=2**32),)), "out of range"),
        (replace(asset(), files=(replace(lod("a"), level=-1),)), "out of range"),
    ],
)
def test_what_unity_would_misread_is_refused(bad: Asset, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        written(catalogue(bad), 0)


def test_two_assets_of_one_key_or_file_are_refused() -> None:
    with pytest.raises(ValueError, match="two locations have the same key: 'captures/dress/lod0'"):
        written(catalogue(asset(), asset()), 1)
    with pytest.raises(ValueError, match="two locations have the same key: 'captures/dress/lod0'"):
        written(catalogue(asset("dress", levels=1), asset("dress/lod0", levels=1)), 1)
    with pytest.raises(ValueError, match="two locations have the same id"):
        written(catalogue(asset("a"), replace(asset("a"), key="b")), 1)


@pytest.mark.slow
@every_form
def test_ten_thousand_assets_are_written_at_once(form: int) -> None:
    """0.8 s on a busy core, the table of locations included. The bound is for slower ones; nothing quadratic fits."""
    made = many(10_000)
    start = time.process_time()
    written(made, form)
    assert time.process_time() - start < 3


@pytest.mark.slow
def test_addressablestools_reads_the_same(addressables_tools: AddressablesTools, tmp_path: Path) -> None:
    """Another program finds the keys, labels, dependencies and sizes in all four forms."""
    made = catalogue(
        asset("dress", "clothes", "Kleid ä"),
        asset("Jäckchen 👗", "clothes", "衣服", version=7, levels=1),
        asset("a" * 300, levels=2),
    )
    paths = []
    for name, data in catalogue_files(made, "museum"):
        path = tmp_path / Path(name).name
        path.write_bytes(data)
        paths += [] if path.suffix == ".hash" else [path]
    empty = [tmp_path / f"empty{path.name}" for path in paths]
    for path, form in zip(empty, FORMS, strict=True):
        path.write_bytes(written(Catalogue("", ()), form))

    found = addressables_tools(*paths, *empty)
    for form, document in zip(FORMS, found, strict=False):
        assert (document["version"], document["locator_id"]) == (form, "capture2vr/demo")
        assert [name for _, name in document["providers"]] == [
            "Capture2vr.GlbFileProvider",
            "Capture2vr.GlbPrefabProvider",
        ]
        assert as_told(document) == as_meant(made)
    assert [document["keys"] for document in found[4:]] == [{}] * 4


def as_told(document: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Types by their class only: the assemblies differ from form to form."""
    return {
        key: [{**location, "type": location["type"][1]} for location in places]
        for key, places in document["keys"].items()
    }


def as_meant(made: Catalogue) -> dict[str, list[dict[str, Any]]]:
    """The keys that Unity should see, spelled out from the assets rather than from the writers' table."""
    expected: dict[str, list[dict[str, Any]]] = {}
    for each in in_order(made.assets):
        address = f"captures/{each.key}"
        for file in each.files:
            expected[f"{address}/lod{file.level}"] = [
                {
                    "key": f"{address}/lod{file.level}",
                    "id": f"{BASE_URL}/{file.url}",
                    "provider": "Capture2vr.GlbFileProvider",
                    "type": "UnityEngine.ResourceManagement.ResourceProviders.IAssetBundleResource",
                    "data": {"hash": file.sha256[:32], "crc": 0, "name": f"lod{file.level}", "size": file.size},
                    "dependencies": [],
                }
            ]
        prefab = {
            "key": address,
            "id": f"{address}@{each.version}",
            "provider": "Capture2vr.GlbPrefabProvider",
            "type": "UnityEngine.GameObject",
            "data": f'{{"version":{each.version}}}',
            "dependencies": [f"{address}/lod{file.level}" for file in each.files],
        }
        expected[address] = [prefab]
        for label in each.labels:
            expected.setdefault(label, []).append(prefab)
    return expected
