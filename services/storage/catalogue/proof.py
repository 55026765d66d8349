"""Signature of one asset's version, in its catalogue entry: for readers who may not read a collection that lists it.

It covers key, version and the manifest's sha256; the manifest lists the sha256 of every file. Published with the
version, by whoever signs the collection.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from services.storage.catalogue.compare_and_swap import canonical_json
from services.storage.catalogue.signing import Signer

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
