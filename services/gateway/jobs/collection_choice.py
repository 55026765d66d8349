"""Choice of the collection that lists a job's asset."""

from __future__ import annotations

import json

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.capture_objects import receipt_name
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.entry import read_entry, valid_key
from capture2vr.storage.store import Store


def require_collection(name: str, hint: str) -> str:
    """Return the name unchanged. Raises Problem COLLECTION_INVALID for an invalid name."""
    if not valid_key(name):
        detail = say("collection_name_must_have_1")
        raise Problem(422, "COLLECTION_INVALID", detail, hints=(hint,))
    return name


def choose_collection(store: Store, *, named: str, capture: str, key: str) -> str:
    """Return the collection that the job names, else the one that its upload named, else the one with the asset.

    "" leaves the choice to the worker. A key is unique in the whole store: an asset of another collection with the same
    key would get a new version by this job, so that is refused. Raises Problem COLLECTION_INVALID, KEY_ELSEWHERE;
    OSError.
    """
    if named:
        require_collection(named, say("change_collection_leave_empty"))
    collection = named or _upload_collection(store, capture)
    try:
        listed_in = read_entry(store, key).collections
    except FileNotFoundError:
        return collection
    if collection and collection not in listed_in:
        detail = say("asset_with_key_exists_already", key=key, found=listed_in[0], wanted=collection)
        raise Problem(
            409, "KEY_ELSEWHERE", detail, hints=(say("choose_another_key"), say("use_collection", name=listed_in[0]))
        )
    return collection or listed_in[0]


def _upload_collection(store: Store, capture: str) -> str:
    """Return the collection that the capture's upload named; "" where it named none, or is older than collections."""
    try:
        return str(json.loads(store.get(receipt_name(capture))).get("collection", ""))
    except FileNotFoundError:
        return ""
