"""The table that Unity catalogues hold, written beside them for a stub of Addressables that reads no form of them."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.listing import FILE_PROVIDER, PREFAB_PROVIDER, Listing
from capture2vr.storage.unity.publication import catalogue_names

TABLE = catalogue_names("default")[0].catalogue + ".table"
"""Where it is in a store."""


def tabulate(folder: Path) -> Listing:
    """Write the table of the collection "default" in a store, and return it."""
    listing = read_json_catalogue((folder / catalogue_names("default")[0].catalogue).read_bytes())
    providers = [asdict(FILE_PROVIDER), asdict(PREFAB_PROVIDER)]
    (folder / TABLE).write_text(json.dumps(asdict(listing) | {"providers": providers}))
    return listing
