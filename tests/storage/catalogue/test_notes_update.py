"""Notes: pinned without a new version, all kept when several write at once, carried into the next version's frame."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.catalogue.asset_notes import MOST_NOTES, Note, NoteRefused, carry
from capture2vr.storage.catalogue.change_entry import change_entry, change_names
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.notes_update import UnknownNote, add_note, change_note, remove_note
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.signing import NO_KEYS
from capture2vr.storage.catalogue.versions import restore_version
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from tests.support.bundles import bundle

MARKUP = '<img src=x onerror="alert(1)">'
HALF_TURN = [-2.0, 0, 0, 1, 0, 2, 0, -3, 0, 0, -2, 0.5, 0, 0, 0, 1]
"""Twice as large, turned about Y, moved."""
PLAIN = np.eye(4).ravel().tolist()


@pytest.fixture
def store() -> MemoryStore:
    store = MemoryStore()
    publish(bundle(capture_to_asset=PLAIN), store, key="dress", job="one")
    return store


def pin(store: MemoryStore | LocalStore, text: str = "A stain", at: tuple[float, float, float] = (0.5, 1, 2)) -> Note:
    return add_note(store, "dress", text=text, at=at, normal=(0, 0, 2), author="Ada")


def test_notes_are_pinned_changed_and_removed_and_make_no_version(store: MemoryStore) -> None:
    before = read_entry(store, "dress")
    first, second = pin(store, f" {MARKUP}\r\nTwo\tlines "), pin(store)
    assert (first.text, first.normal, first.author, first.version) == (f"{MARKUP}\nTwo lines", (0, 0, 1), "Ada", 1)
    change_names(store, "dress", label="Gown")
    changed = change_note(store, "dress", first.id, text="Clean", at=None, normal=None)
    assert (changed.text, changed.at, changed.normal, bool(changed.edited)) == ("Clean", first.at, first.normal, True)
    moved = change_note(store, "dress", first.id, text=None, at=(0, 0, 0), normal=None)
    assert (moved.text, moved.at, moved.normal) == ("Clean", (0, 0, 0), None)
    entry = read_entry(store, "dress")
    assert entry.notes == (moved, second)
    assert [entry.document[each] for each in ("versions", "manifest")] == [
        before.document[each] for each in ("versions", "manifest")
    ]
    remove_note(store, "dress", first.id)
    assert read_entry(store, "dress").notes == (second,)
    with pytest.raises(UnknownNote):
        remove_note(store, "dress", first.id)


def test_what_is_no_note_is_refused_and_nothing_is_lost(store: MemoryStore) -> None:
    kept = pin(store)
    for text in ("", "  \n ", "a" * 501, "a\u202eb", "a\x00b"):
        with pytest.raises(NoteRefused):
            pin(store, text)
    for at in ((9.0, 0, 0), (0, -2, 0), (float("nan"), 0, 0), (0, 0, float("inf"))):
        with pytest.raises(NoteRefused, match="far away"):
            pin(store, at=at)
    with pytest.raises(NoteRefused, match="length"):
        add_note(store, "dress", text="a", at=(0, 0, 0), normal=(0, 0, 0), author="")
    with pytest.raises(FileNotFoundError):
        add_note(store, "shoe", text="a", at=(0, 0, 0), normal=None, author="")
    assert read_entry(store, "dress").notes == (kept,)


def test_writers_at_once_lose_nothing(tmp_path: Path) -> None:
    store = LocalStore(tmp_path)
    publish(bundle(), store, key="dress")
    with ThreadPoolExecutor(2) as pool:
        texts = {note.text for note in pool.map(lambda place: pin(store, f"note {place}"), range(12))}
    assert {note.text for note in read_entry(store, "dress").notes} == texts
    assert len(texts) == 12


def test_there_is_a_limit(store: MemoryStore) -> None:
    note = pin(store)
    notes = [{**note.as_json, "id": f"note_{place:016x}"} for place in range(MOST_NOTES)]
    change_entry(store, "dress", NO_KEYS, lambda *_: {"notes": notes})
    with pytest.raises(NoteRefused, match="at most 100"):
        pin(store)
    remove_note(store, "dress", "note_" + "0" * 16)
    assert pin(store).text == note.text


def test_the_next_version_of_a_job_carries_them_into_its_frame(store: MemoryStore) -> None:
    pin(store)
    publish(bundle("refined", capture_to_asset=HALF_TURN), store, key="dress", job="one")
    (note,) = read_entry(store, "dress").notes
    assert note.at == pytest.approx((0, -1, -3.5))
    assert note.normal == pytest.approx((0, 0, -1))
    assert (note.version, note.frame) == (1, 2)


def test_edits_of_one_capture_carry_them_and_another_capture_leaves_them(store: MemoryStore) -> None:
    edited = {"edits": {"capture": "cap_1"}, "capture_to_asset": PLAIN}
    publish(bundle("refined", "b", **edited), store, key="dress", job="two")
    pin(store)
    publish(bundle("refined", "c", **{**edited, "capture_to_asset": HALF_TURN}), store, key="dress", job="three")
    (note,) = read_entry(store, "dress").notes
    assert (note.version, note.frame) == (2, 3)
    publish(bundle("refined", "d", edits={"capture": "cap_2"}, capture_to_asset=PLAIN), store, key="dress", job="four")
    (left,) = read_entry(store, "dress").notes
    assert (left.at, left.frame) == (note.at, 3), "it may be displaced, and says of which version it is"
    publish(bundle("refined", "e", edits={"capture": "cap_2"}, capture_to_asset=HALF_TURN), store, key="dress", job="5")
    assert read_entry(store, "dress").notes == (left,), "what was left behind once is not carried on by chance"
    restore_version(store, "dress", 2)
    assert read_entry(store, "dress").notes == (left,)


_matrices = st.builds(
    lambda quaternion, scale, move: _similarity(np.array(quaternion), scale, np.array(move)),
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda each: np.linalg.norm(each) > 0.1),
    st.floats(0.01, 100),
    st.tuples(*[st.floats(-10, 10)] * 3),
)


def _similarity(quaternion: np.ndarray, scale: float, move: np.ndarray) -> np.ndarray:
    w, *axis = quaternion / np.linalg.norm(quaternion)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = scale * (np.eye(3) + 2 * w * skew + 2 * skew @ skew)
    matrix[:3, 3] = move
    return matrix


@given(before=_matrices, after=_matrices, at=st.tuples(*[st.floats(-10, 10)] * 3))
def test_carrying_is_the_change_of_frames(
    before: np.ndarray, after: np.ndarray, at: tuple[float, float, float]
) -> None:
    note = Note("note_0", "a", at, (0, 1, 0), "", "", "", 1, 1)
    carried = carry(note, before.ravel().tolist(), after.ravel().tolist(), 2)
    change = after @ np.linalg.inv(before)
    assert carried.at == pytest.approx((change @ [*at, 1])[:3], rel=1e-6, abs=1e-6)
    turned = change[:3, 1] / np.linalg.norm(change[:3, 1])
    assert carried.normal == pytest.approx(turned, abs=1e-6)
