"""Pages read collections as trees: down to one shard for one asset, in order for many, and never all of very many."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.clients.catalogue_tree import RECORD, Tree, TreeWriter, hexadecimal, row
from tests.support.page_scripts import PageScripts, running

ROOT = "/v1/collections/default?form=tree"
BASE = "https://cdn.example/"
WRITER = TreeWriter()
KEYS = [f"k{place:03}" for place in range(40)]
SHAPES = {0: KEYS[:9], 1: KEYS[:30], 2: KEYS}
"""Keys of trees of each depth, at 4 rows a shard and 3 children a node."""
_A_KEY = st.builds(str.__add__, st.sampled_from("aZ0"), st.text("aZ0._-", max_size=3))

_DEVICE = """async ({ root, base, roots, files, publicKeys, endless, calls }) => {
  const items = new Map();
  Object.assign(globalThis, {
    document: { cookie: '', documentElement: { lang: 'en' }, getElementById: () => null },
    location: { search: '', pathname: '/', origin: 'https://pages.example' },
    localStorage: { getItem: (name) => items.get(name) ?? null, setItem: (name, value) => items.set(name, value) },
  });
  const asked = [];
  let sent = 0;
  const drip = () =>
    new ReadableStream({ pull: (to) => to.enqueue(new Uint8Array((sent += 1000) && 1000).fill(32)) });
  globalThis.fetch = async (url) => {
    asked.push(url);
    if (url === '/v1/keys') return Response.json({ keys: publicKeys });
    if (url === root) return Response.json({ ...(roots.length > 1 ? roots.shift() : roots[0]), base });
    const name = url.slice(base.length);
    if (name === endless) return new Response(drip());
    return name in files ? new Response(files[name]) : new Response('none', { status: 404 });
  };
  const signed = await import('/web/catalogue/signed-catalogue.js');
  const rows = await import('/web/catalogue/collection-rows.js');
  const { search } = await import('/web/collection/search.js');
  const kinds = {
    find: (collection, key) => rows.findRow(collection, key),
    list: async (collection, shards) => {
      const found = [];
      for await (const some of rows.walkRows(collection)) if (found.push(some) === shards) break;
      return found.flat();
    },
    search: (collection, [query, page]) => search(collection, query, page),
  };
  const answers = [];
  for (const [kind, argument] of calls) {
    asked.length = 0;
    const answer = await signed
      .withNewest('default', (collection) => kinds[kind](collection, argument))
      .then((value) => ({ value: value ?? null }), ({ code, message }) => ({ code: code ?? message }));
    answers.push({ ...answer, asked: asked.filter((url) => url !== '/v1/keys'), sent });
  }
  return answers;
}"""
EVERYTHING = {"words": "", "order": "", "state": "", "since": "", "until": "", "least": "", "most": ""}


@pytest.fixture(scope="module")
def device() -> Iterator[PageScripts]:
    """A process of its own: it has what only pages have, such as a document."""
    with running() as scripts:
        yield scripts


def root_of(tree: Tree, file: str = "root.json") -> Any:
    return json.loads(tree.files[tree.name(file)])


def ask(device: PageScripts, trees: list[Any], files: dict[str, bytes], *calls: Any, endless: str = "") -> list[Any]:
    """What a device without a past answers to calls, each with what it asked the server for."""
    told = {name: data.decode() for name, data in files.items()}
    keys = [{"key": WRITER.key_id, "ed25519": WRITER.public_key}]
    server = {"root": ROOT, "base": BASE}
    arguments = {**server, "roots": trees, "files": told, "publicKeys": keys, "endless": endless, "calls": calls}
    answers: list[Any] = device.evaluate(_DEVICE, arguments)
    return answers


def keys_of(answer: Any) -> list[str]:
    return [each["key"] for each in answer["value"]]


@pytest.mark.parametrize("depth", SHAPES)
def test_one_asset_costs_the_root_and_one_object_of_each_level(device: PageScripts, depth: int) -> None:
    tree = WRITER.write([row(key) for key in SHAPES[depth]])
    assert tree.depth == depth
    found = ask(device, [root_of(tree)], tree.files, *(["find", key] for key in SHAPES[depth]))
    for key, answer in zip(SHAPES[depth], found, strict=True):
        assert answer["value"]["key"] == key
        assert answer["asked"] == [ROOT, *(BASE + name for name in tree.path_to(key))]
        assert len(answer["asked"]) == depth + 2


@settings(max_examples=15, deadline=None)
@given(
    keys=st.lists(_A_KEY, max_size=60, unique=True),
    absent=_A_KEY,
    shard_rows=st.integers(1, 5),
    node_children=st.integers(2, 5),
)
def test_every_tree_lists_its_rows_in_order_and_has_no_other(
    device: PageScripts, keys: list[str], absent: str, shard_rows: int, node_children: int
) -> None:
    rows = [row(key, label=f"Thing {key}") for key in sorted(keys)]
    tree = TreeWriter(WRITER.key, shard_rows=shard_rows, node_children=node_children).write(rows)
    listed, found, *each = ask(
        device, [root_of(tree)], tree.files, ["list", -1], ["find", absent], *(["find", key] for key in keys)
    )
    assert [(one["key"], one["label"]) for one in listed["value"]] == [(one["key"], one["label"]) for one in rows]
    assert (found["value"] is not None) == (absent in keys)
    assert [one["value"]["key"] for one in each] == keys


def test_a_list_reads_no_further_than_it_is_looked_at(device: PageScripts) -> None:
    tree = WRITER.write([row(key) for key in KEYS])
    (first,) = ask(device, [root_of(tree)], tree.files, ["list", 1])
    assert keys_of(first) == KEYS[:4]
    assert first["asked"] == [ROOT, *(BASE + name for name in tree.path_to(KEYS[0]))]


def test_an_index_of_a_gateway_that_knows_no_trees_is_read_the_same(device: PageScripts) -> None:
    tree = WRITER.write([row(key) for key in SHAPES[0]])
    children = json.loads(root_of(tree)["signed"])["children"]
    shards = [{**dict(zip(RECORD, child, strict=True)), "sha256": hexadecimal(child[0])} for child in children]
    index = {"schema": 1, "collection": "default", "version": 3, "shards": shards}
    listed, found = ask(device, [json.loads(WRITER.envelope(index))], tree.files, ["list", -1], ["find", KEYS[5]])
    assert keys_of(listed) == SHAPES[0]
    assert found["asked"] == [ROOT, *(BASE + name for name in tree.path_to(KEYS[5]))]


@pytest.mark.parametrize("place", [0, 1, 2])
def test_where_a_node_or_a_shard_has_gone_it_begins_again_at_a_newer_root(device: PageScripts, place: int) -> None:
    old, new = (TreeWriter(WRITER.key, version=version, commit=str(version)) for version in (1, 2))
    before, after = (writer.write([row(key, version=writer.version) for key in KEYS]) for writer in (old, new))
    files = after.files | before.files
    del files[before.path_to(KEYS[7])[place]]
    (found,) = ask(device, [root_of(before), root_of(after)], files, ["find", KEYS[7]])
    assert found["value"]["version"] == 2
    (absent,) = ask(device, [root_of(before)], files, ["find", KEYS[7]])
    assert absent["code"] == "ASSET_ABSENT"
    assert absent["asked"].count(ROOT) == 3


@pytest.mark.parametrize("place", [0, 2])
def test_what_was_changed_is_refused_and_no_more_of_it_read_than_its_size(device: PageScripts, place: int) -> None:
    tree = WRITER.write([row(key) for key in KEYS])
    name = tree.path_to(KEYS[7])[place]
    changed = tree.files | {name: tree.files[name].replace(b'"k0', b'"j0')}
    (answer,) = ask(device, [root_of(tree)], changed, ["find", KEYS[7]])
    assert answer["code"] == "ASSET_TAMPERED"
    (answer,) = ask(device, [root_of(tree)], tree.files, ["find", KEYS[7]], endless=name)
    assert answer["code"] == "ASSET_TAMPERED"
    assert answer["sent"] < 2 * (len(tree.files[name]) + 10_000)


def test_older_and_forged_roots_are_refused(device: PageScripts) -> None:
    rows = [row(key) for key in KEYS]
    newer, older = (root_of(TreeWriter(WRITER.key, version=version).write(rows)) for version in (8, 7))
    files = WRITER.write(rows).files
    forged = newer | {"signed": newer["signed"].replace('"version": 8', '"version": 9')}
    codes = [answer.get("code") for answer in ask(device, [newer, older, forged], files, *([["find", "a"]] * 3))]
    assert codes == [None, "CATALOGUE_OLDER", "CATALOGUE_FORGED"]


@pytest.mark.parametrize(
    "changes",
    [
        {"depth": 9},
        {"depth": None},
        {"children": [["A" * 42, 10, 1, "a", "a"]]},
        {"children": [["../" + "A" * 40, 10, 1, "a", "a"]]},
        {"children": [["A" * 43, 2**24 + 1, 1, "a", "a"]]},
        {"children": [["A" * 43, -1, 1, "a", "a"]]},
        {"children": None},
    ],
)
def test_a_root_that_is_none_is_refused(device: PageScripts, changes: dict[str, Any]) -> None:
    tree = WRITER.write([row(key) for key in KEYS], **changes)
    (answer,) = ask(device, [root_of(tree)], tree.files, ["find", "a"])
    assert answer["code"] == "CATALOGUE_TRUNCATED"
    assert answer["asked"] == [ROOT]


@pytest.mark.slow
def test_of_a_large_collection_a_page_looks_through_the_first_ten_thousand(device: PageScripts) -> None:
    writer = TreeWriter(WRITER.key, shard_rows=48, node_children=48)
    rows = [row(f"k{place:05}", updated=place) for place in range(10_600)]
    tree = writer.write(rows)
    first, newest, rare, last = ask(
        device,
        [root_of(tree)],
        tree.files,
        ["search", [EVERYTHING, 1]],
        ["search", [{**EVERYTHING, "order": "newest"}, 1]],
        ["search", [{**EVERYTHING, "words": "k10599"}, 1]],
        ["search", [EVERYTHING, 209]],
    )
    assert len(first["asked"]) == 1 + 1 + 3, "root, node, and shards: one, then two, for this page and one row more"
    assert (len(first["value"]["rows"]), first["value"]["isCut"]) == (48, False)
    looked_through = 48 * 209
    assert [newest["value"][name] for name in ("count", "exact", "isCut")] == [looked_through, False, True]
    assert newest["value"]["rows"][0]["updated"] == looked_through - 1
    assert [rare["value"][name] for name in ("count", "exact", "isCut")] == [0, False, True]
    assert [last["value"][name] for name in ("count", "isCut")] == [looked_through, True]
    assert len(last["value"]["rows"]) == 48
