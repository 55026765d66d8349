"""Signature of one asset's version, in its catalogue entry: for readers who may not read a collection that lists it.

It covers key, version and the manifest's sha256; the manifest lists the sha256 of every file. Published with the
version, by whoever signs the collection.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import entry_name
from capture2vr.storage.catalogue.faults import CATALOGUE_OLDER, CATALOGUE_OTHER, SIGNATURE_MISSING, CatalogueFault
from capture2vr.storage.catalogue.signing import PublicKey, Signer, check_signatures

SCHEMA = 1


def sign_proof(key: str, document: Mapping[str, Any], signers: Sequence[Signer]) -> dict[str, Any]:
    """Return the proof of an entry's current version: the signed text, and the signature of every signer."""
    facts = {
        "schema": SCHEMA,
        "asset": key,
        "version": document["version"],
        "manifest": document["manifest"]["sha256"],
    }
    text = canonical_json(facts)
    return {"signed": text.decode(), "signatures": [signer.sign(text) for signer in signers]}


def check_proof(
    key: str, document: Mapping[str, Any], verification_keys: tuple[PublicKey, ...], *, at_least: int = 0
) -> int:
    """Check that an entry's manifest was signed for this asset, and return the signed version; without keys, its own.

    at_least  the highest version seen before: an older one is refused, even with a valid signature
    Raises CatalogueFault SIGNATURE_*, KEY_UNKNOWN, CATALOGUE_OTHER, CATALOGUE_OLDER.
    """
    name = entry_name(key)
    if not verification_keys:
        return int(document["version"])
    try:
        text, signatures = document["proof"]["signed"], document["proof"]["signatures"]
        facts = json.loads(text)
        check_signatures(name, text.encode(), signatures, verification_keys)
        same = (facts["asset"], facts["manifest"]) == (key, document["manifest"]["sha256"])
        version = int(facts["version"])
    except (ValueError, KeyError, TypeError, AttributeError):
        hint = "publish it again with a signing key"
        raise CatalogueFault(SIGNATURE_MISSING, name, "this version is not signed by itself", hint=hint) from None
    if not same:
        raise CatalogueFault(CATALOGUE_OTHER, name, "the signature is that of something else")
    if version < at_least:
        raise CatalogueFault(
            CATALOGUE_OLDER, name, f"version {version} is older than {at_least}, which was seen before"
        )
    return version
