"""The work behind `capture2vr catalogue`: a collection followed hash by hash, written anew, and the keys for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
from rich.table import Table

from services.cli.assets import check_collection
from services.cli.errors import BadInput, answer_of
from services.cli.http import client_of
from services.cli.progress import console, warn
from services.storage.catalogue import DEFAULT_COLLECTION
from services.storage.collect import rebuild
from services.storage.collection import index_name
from services.storage.reading import collections
from services.storage.settings import StorageSettings, open_keys, open_store
from services.storage.signing import Keys, Public, generate, read_public
from services.storage.verify import Checked, Fetch, fetch_from, verify

_SHOWN = 20  # faults of one class; there may be thousands
_BLOCK_BYTES = 1 << 20


def verify_collection(collection: str, gateway: str, trusted: Sequence[Path], *, at_least: int) -> bool:
    """Print what is checked, class by class, and what is wrong; whether all of it is right. Raises BadInput.

    gateway  its URL; "": the store of the STORAGE_* variables
    trusted  files of public keys; none: those of the STORAGE_* variables
    """
    check_collection(collection)
    believed = believed_keys(trusted)
    if not believed:
        warn("no public key is named, so the signature is not checked: --trusted key.pub")
    try:
        lines = _lines(collection, gateway, believed, at_least)
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    _show(collection, lines)
    return not lines[-1].faults


def on_the_store() -> list[str]:
    """The collections of the STORAGE_* variables' store; one that is older than collections has the default one."""
    return list(collections(open_store(_settings()))) or [DEFAULT_COLLECTION]


def rebuild_collection(collection: str) -> None:
    """Write a collection of the STORAGE_* variables' store anew, and sign it with their keys. Raises BadInput."""
    check_collection(collection)
    settings = _settings()
    keys = _keys(settings)
    index = rebuild(open_store(settings), collection, keys)
    count = sum(shard.count for shard in index.shards)
    signed = f"signed by {', '.join(each.public.id for each in keys.signers)}" if keys.signers else "not signed"
    console.print(f"{collection} version {index.version}: {count:,} assets in {len(index.shards)} shards, {signed}")


def make_key(out: Path) -> None:
    """A private key in a file, and its public half beside it. Raises FileExistsError."""
    public = generate(out)
    console.print(f"key {public.id}: {out} signs, keep it to the services; {out}.pub is for everybody who reads")


def _lines(collection: str, gateway: str, believed: tuple[Public, ...], at_least: int) -> list[Checked]:
    if not gateway:
        return list(verify(fetch_from(open_store(_settings())), collection, believed, at_least=at_least))
    with client_of(gateway, follow_redirects=True) as client:
        answer = client.get(f"/v1/collections/{collection}")
        fetch = _fetch_over(client, str(answer_of(answer)["base"]), {index_name(collection): answer.content})
        return list(verify(fetch, collection, believed, at_least=at_least))


def _fetch_over(client: httpx.Client, base: str, known: dict[str, bytes]) -> Fetch:
    """The objects below a URL, but for those that are known."""

    def fetch(name: str) -> Iterator[bytes]:
        if name in known:
            yield known[name]
            return
        with client.stream("GET", base + name) as response:
            if response.status_code in (403, 404):  # a bucket that may not be listed says 403 of what is not there
                raise FileNotFoundError(name)
            if not response.is_success:
                raise BadInput(f"{response.request.url} answered {response.status_code}")
            yield from response.iter_bytes(_BLOCK_BYTES)

    return fetch


def _show(collection: str, lines: list[Checked]) -> None:
    table = Table(title=f"collection {collection}")
    for column in ("what", "checked", "bytes", "faults", ""):
        table.add_column(column, justify="left" if column in ("what", "") else "right", overflow="fold")
    for line in lines:
        table.add_row(line.what, f"{line.count:,}", f"{line.bytes:,}", f"{len(line.faults):,}", line.said)
    console.print(table)
    faults = lines[-1].faults
    for fault in faults[:_SHOWN]:
        console.print(f"{fault.code}  {fault}", soft_wrap=True, markup=False)
    if len(faults) > _SHOWN:
        console.print(f"and {len(faults) - _SHOWN:,} more")


def believed_keys(trusted: Sequence[Path]) -> tuple[Public, ...]:
    """The public keys in these files; of the STORAGE_* variables where none is named. Raises BadInput."""
    if not trusted:
        return _keys(_settings()).believed
    try:
        return tuple(read_public(path) for path in trusted)
    except ValueError as error:
        raise BadInput(f"--trusted: {error}") from error


def _keys(settings: StorageSettings) -> Keys:
    try:
        return open_keys(settings)
    except ValueError as error:
        raise BadInput(str(error)) from error


def _settings() -> StorageSettings:
    try:
        return StorageSettings()
    except ValueError as error:
        raise BadInput(str(error)) from error
