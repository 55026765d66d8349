"""Implementation of `capture2vr catalogue`: verify a collection, rebuild it, generate its keys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx
from rich.table import Table

from capture2vr.cli.progress import console, warn
from capture2vr.client.answers import parse_answer
from capture2vr.client.http import open_gateway
from capture2vr.client.names import check_collection
from capture2vr.client.trusted_keys import load_verification_keys, storage_keys, storage_settings
from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.catalogue.reader import collection_names
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import PublicKey, generate_key
from capture2vr.storage.catalogue.update import rebuild
from capture2vr.storage.catalogue.verify import CheckResult, Fetch, fetch_from, verify
from capture2vr.storage.settings import open_store

_MOST_SHOWN = 20  # faults printed of one kind; there may be thousands
_BLOCK_BYTES = 1 << 20  # per read of a download


def verify_collection(collection: str, gateway: str, trusted: Sequence[Path], *, at_least: int) -> bool:
    """Verify a collection, print the results, and return whether it has no faults. Raises BadInput.

    gateway  its URL; "": use the store of the STORAGE_* variables
    trusted  files of public keys; none: those of the STORAGE_* variables
    """
    check_collection(collection)
    verification_keys = load_verification_keys(trusted)
    if not verification_keys:
        warn("the signature is not checked, because no public key is given: use --trusted key.pub")
    results = _verify(collection, gateway, verification_keys, at_least)
    _print_results(collection, results)
    return not results[-1].faults


def stored_collections() -> list[str]:
    """Return the collections on the store of the STORAGE_* variables; the default one where there are none yet."""
    return list(collection_names(open_store(storage_settings()))) or [DEFAULT_COLLECTION]


def rebuild_collection(collection: str) -> None:
    """Rebuild a collection on the store of the STORAGE_* variables, and sign it with their keys. Raises BadInput."""
    check_collection(collection)
    settings = storage_settings()
    keys = storage_keys(settings)
    index = rebuild(open_store(settings), collection, keys)
    signed = f"signed by {', '.join(each.public.id for each in keys.signers)}" if keys.signers else "not signed"
    console.print(f"{collection} version {index.version}: {index.count:,} assets, {signed}")


def make_key(out: Path) -> None:
    """Generate a key pair: the private key in `out`, the public key in `out`.pub. Raises FileExistsError."""
    public = generate_key(out)
    console.print(f"key {public.id}: {out} is the private key, keep it secret; {out}.pub is the public key for readers")


def _verify(
    collection: str, gateway: str, verification_keys: tuple[PublicKey, ...], at_least: int
) -> list[CheckResult]:
    if not gateway:
        stored = fetch_from(open_store(storage_settings()))
        return list(verify(stored, collection, verification_keys, at_least=at_least))
    with open_gateway(gateway, follow_redirects=True) as client:
        answer = client.get(f"/v1/collections/{collection}", params={"form": "tree"})
        fetch = _fetch_from_url(client, str(parse_answer(answer)["base"]), {root_name(collection): answer.content})
        return list(verify(fetch, collection, verification_keys, at_least=at_least))


def _fetch_from_url(client: httpx.Client, base: str, known: dict[str, bytes]) -> Fetch:
    """Return a `Fetch` that downloads objects below a URL, except for those in `known`, by name."""

    def fetch(name: str) -> Iterator[bytes]:
        if name in known:
            yield known[name]
            return
        with client.stream("GET", base + name) as response:
            if response.status_code in (403, 404):  # S3 answers 403 for a missing object if listing is not allowed
                raise FileNotFoundError(name)
            if not response.is_success:
                raise BadInput(f"{response.request.url} answered {response.status_code}")
            yield from response.iter_bytes(_BLOCK_BYTES)

    return fetch


def _print_results(collection: str, results: list[CheckResult]) -> None:
    table = Table(title=f"collection {collection}")
    for column in ("what", "checked", "bytes", "faults", ""):
        table.add_column(column, justify="left" if column in ("what", "") else "right", overflow="fold")
    for result in results:
        table.add_row(result.kind, f"{result.count:,}", f"{result.bytes:,}", f"{len(result.faults):,}", result.summary)
    console.print(table)
    faults = results[-1].faults
    for fault in faults[:_MOST_SHOWN]:
        console.print(f"{fault.code}  {fault}", soft_wrap=True, markup=False)
    if len(faults) > _MOST_SHOWN:
        console.print(f"and {len(faults) - _MOST_SHOWN:,} more faults")
