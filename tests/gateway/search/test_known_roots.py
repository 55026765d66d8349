"""What changed since a root is told as long as the root is known and its nodes are there."""

from __future__ import annotations

from functools import partial

from capture2vr.gateway.search.known_roots import KnownRoots, token_of
from capture2vr.storage.catalogue.commit import commit, forget_retired
from capture2vr.storage.catalogue.reader import parts_on
from capture2vr.storage.catalogue.signing import NO_KEYS
from capture2vr.storage.memory import MemoryStore
from tests.storage.catalogue.test_tree import built, row


def test_what_changed_since_a_known_root() -> None:
    store, roots = MemoryStore(), KnownRoots()
    before = built(store, 3000)
    roots.remember("ada", before)
    index = commit(store, "c", lambda _: {"a0000007": row("a0000007", 2)}, NO_KEYS)
    changed = partial(roots.changed, "ada", index, parts_on(store, "c").nodes)
    found = changed(token_of(before))
    assert found is not None
    (gone,), (new,) = found
    assert (gone.first, gone.count) == (new.first, new.count)
    assert gone.sha256 != new.sha256
    assert changed("1.another") is None
    assert roots.changed("bob", index, parts_on(store, "c").nodes, token_of(before)) is None
    index = forget_retired(store, "c", NO_KEYS)
    assert roots.changed("ada", index, parts_on(store, "c").nodes, token_of(before)) is None, "its nodes are gone"
