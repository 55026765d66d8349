"""Which collection a job's asset is listed in."""

from __future__ import annotations

import json

from services.gateway.errors import Problem
from services.gateway.jobs.source import receipt_name
from services.storage.catalogue import entry, valid_key
from services.storage.store import Store


def require_collection(name: str, hint: str) -> str:
    """The name itself. Raises Problem COLLECTION_INVALID."""
    if not valid_key(name):
        detail = "a collection's name has 1 to 100 of A-Z a-z 0-9 . _ - and begins with a letter or digit"
        raise Problem(422, "COLLECTION_INVALID", detail, hints=(hint,))
    return name


def collection_for(store: Store, *, named: str, capture: str, key: str) -> str:
    """What the job names, else what its upload named, else where the asset is already; "" leaves it to the worker.

    A key means one asset in the whole store. Under a name of another collection it would become a new version of what
    somebody else has there, so that is refused. Raises Problem COLLECTION_INVALID, KEY_ELSEWHERE; OSError.
    """
    if named:
        require_collection(named, "name another in `collection`, or none")
    wanted = named or _uploaded_for(store, capture)
    try:
        there = entry(store, key).collections
    except FileNotFoundError:
        return wanted
    if wanted and wanted not in there:
        detail = f"there is an asset {key} already, in collection {there[0]}, not in {wanted}"
        raise Problem(409, "KEY_ELSEWHERE", detail, hints=("choose another key", f"or name collection {there[0]}"))
    return wanted or there[0]


def _uploaded_for(store: Store, capture: str) -> str:
    """What the upload of a capture named; "" too for one that is older than collections."""
    try:
        return str(json.loads(store.get(receipt_name(capture))).get("collection", ""))
    except FileNotFoundError:
        return ""
