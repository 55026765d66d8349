"""`python -m services.storage.bucket`: make the bucket and let anybody read `assets/` and `collections/`, nothing else.

They are meant for any headset, which checks them by signature and hash; captures, and the entries and aliases that
services work with, stay with the services.
"""

from __future__ import annotations

import json
import logging
import sys

from services.storage.settings import StorageSettings, open_store
from services.strict_settings import SettingsError

_log = logging.getLogger(__name__)

PUBLIC_PREFIXES = ("assets/", "collections/")


def read_policy(bucket: str) -> str:
    """The bucket policy (JSON) under which anybody may get an asset or a collection by its name, and list nothing."""
    statement = {
        "Sid": "ReadAssetsAndCollections",
        "Effect": "Allow",
        "Principal": {"AWS": ["*"]},
        "Action": ["s3:GetObject"],
        "Resource": [f"arn:aws:s3:::{bucket}/{prefix}*" for prefix in PUBLIC_PREFIXES],
    }
    return json.dumps({"Version": "2012-10-17", "Statement": [statement]})


def main() -> None:
    """Idempotent: run before the services at every start."""
    from services.storage.s3 import S3Store

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        settings = StorageSettings()
        store = open_store(settings)
        if not isinstance(store, S3Store):
            _log.info("a local store needs no bucket")
            return
        store.create_bucket()
        store.set_policy(read_policy(settings.bucket))
    except (OSError, SettingsError) as error:
        sys.exit(f"bucket: {error}")
    _log.info("bucket %s is ready; anybody may read %s", settings.bucket, ", ".join(PUBLIC_PREFIXES))


if __name__ == "__main__":
    main()
