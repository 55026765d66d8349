"""Scenes in a store: what is saved is read again, nobody overwrites what they have not seen, damage has a name."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.scenes import scene_documents
from capture2vr.storage.scenes.scene import PlacedAsset, Scene, parse_scene
from capture2vr.storage.scenes.scene_documents import (
    SceneChanged,
    TooManyScenes,
    create_scene,
    delete_scene,
    list_scenes,
    read_scene,
    replace_scene,
    scene_name,
)
from capture2vr.storage.store import Store

CHAIR = PlacedAsset("a", "chair", (0.0, 0.0, -1.5))
TABLE = PlacedAsset("b", "table", (1.0, 0.0, -1.5), (0.0, 0.6, 0.0, 0.8), 2.0)

metres = st.floats(-100, 100)
quaternions = st.sampled_from([(0.0, 0.0, 0.0, 1.0), (0.5, 0.5, 0.5, -0.5), (0.6, 0.0, 0.8, 0.0)])
documents = st.recursive(st.none() | st.text() | st.floats(), st.lists)
placed = st.builds(
    PlacedAsset,
    st.from_regex(r"[A-Za-z0-9_-]{1,40}", fullmatch=True),
    st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", fullmatch=True),
    st.tuples(metres, metres, metres),
    quaternions,
    st.floats(0.05, 20),
)


def test_what_is_saved_is_read_again_listed_and_deleted(store: Store) -> None:
    first = create_scene(store, "Living room", (CHAIR,))
    second = create_scene(store, "Wardrobe", ())
    assert read_scene(store, first.id) == first
    changed = replace_scene(store, first.id, 1, "Room", (CHAIR, TABLE))
    assert (changed.version, changed.name, changed.items, changed.created) == (2, "Room", (CHAIR, TABLE), first.created)
    one, other = sorted((changed, second), key=lambda scene: scene.id)  # made within a millisecond
    assert list_scenes(store, limit=1) == ([one], one.id)
    assert list_scenes(store, after=one.id, limit=1) == ([other], None)
    delete_scene(store, first.id)
    for gone in (read_scene, delete_scene):
        with pytest.raises(FileNotFoundError):
            gone(store, first.id)
    with pytest.raises(FileNotFoundError):
        replace_scene(store, first.id, 2, "Room", ())


def test_a_change_of_an_older_version_is_refused_and_writes_nothing(store: Store) -> None:
    scene = create_scene(store, "Room", (CHAIR,))
    changed = replace_scene(store, scene.id, 1, "Room", (TABLE,))
    with pytest.raises(SceneChanged) as refused:
        replace_scene(store, scene.id, 1, "Room", ())
    assert refused.value.present == changed == read_scene(store, scene.id)


def test_of_many_who_change_one_version_one_wins(store: Store) -> None:
    scene = create_scene(store, "Room", ())

    def change(number: int) -> str:
        try:
            return replace_scene(store, scene.id, 1, f"by {number}", ()).name
        except SceneChanged:
            return ""

    with ThreadPoolExecutor(8) as threads:
        winners = [name for name in threads.map(change, range(8)) if name]
    assert winners == [read_scene(store, scene.id).name]
    assert read_scene(store, scene.id).version == 2


def test_a_tenant_has_so_many_scenes_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_documents, "MOST_SCENES", 2)
    store = MemoryStore()
    for _ in range(2):
        create_scene(store, "Room", ())
    with pytest.raises(TooManyScenes):
        create_scene(store, "Room", ())


@given(items=st.lists(placed, max_size=5, unique_by=lambda each: each.id), name=st.sampled_from(["Room", "Größe 🪑"]))
def test_any_scene_survives_the_store(items: list[PlacedAsset], name: str) -> None:
    store = MemoryStore()
    scene = create_scene(store, name, tuple(items))
    assert read_scene(store, scene.id) == scene


@pytest.mark.slow
@given(st.binary(max_size=200) | documents.map(json.dumps).map(str.encode))
def test_what_is_no_scene_is_a_fault_that_names_the_object(data: bytes) -> None:
    with pytest.raises(CatalogueFault, match=r"scenes/x\.json"):
        parse_scene("scenes/x.json", data)


@pytest.mark.parametrize(
    "change",
    [
        {"version": 0},
        {"name": ""},
        {"name": "a\nb"},
        {"name": "x" * 101},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, 0]}]},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, 0, 1e9]}]},
        {"items": [{"id": "a", "asset": "../chair", "position_m": [0, 0, 0]}]},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, 0, 0], "rotation": [0, 0, 0, 0]}]},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, 0, 0], "scale": 0}]},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, True, 0]}]},
        {"items": [{"id": "a", "asset": "chair", "position_m": [0, 0, 0]}] * 2},
        {"items": [{"id": str(each), "asset": "chair", "position_m": [0, 0, 0]} for each in range(51)]},
        {"colour": "red"},
    ],
)
def test_a_document_with_one_wrong_field_is_refused(change: dict[str, object]) -> None:
    good = create_scene(MemoryStore(), "Room", (CHAIR,)).as_json
    assert isinstance(parse_scene("x", json.dumps(good).encode()), Scene)
    with pytest.raises(CatalogueFault):
        parse_scene("x", json.dumps(good | change).encode())


def test_a_damaged_scene_is_left_out_of_the_list_and_can_be_deleted() -> None:
    store = MemoryStore()
    scene, other = create_scene(store, "Room", (CHAIR,)), create_scene(store, "Other", ())
    store.put(scene_name(scene.id), b"{", content_type="application/json")
    assert list_scenes(store) == ([other], None)
    with pytest.raises(CatalogueFault, match="damaged"):
        replace_scene(store, scene.id, 1, "Room", ())
    delete_scene(store, scene.id)


def test_a_rotation_is_a_unit_quaternion() -> None:
    with pytest.raises((ValueError, ValidationError), match="unit quaternion"):
        PlacedAsset("a", "chair", (0, 0, 0), (0, 0, 0, 2))
