"""`python -m services.storage.bucket`: create the S3 bucket; make `assets/` and `collections/` readable by everybody.

Headsets read these two without credentials and check them by signature and hash. Captures, catalogue entries and
aliases stay private. With STORAGE_PRESIGN_S everything stays private, and the gateway presigns what somebody may read.
"""

from __future__ import annotations

import json
import logging
import sys

from services.storage.settings import StorageSettings, open_store
from services.strict_settings import SettingsError

_log = logging.getLogger(__name__)

PUBLIC_PREFIXES = ("assets/", "collections/", "tenants/*/assets/", "tenants/*/collections/")
"""Objects that the edge cache reads without credentials; who may read them through it, the gateway says."""


def read_policy(bucket: str) -> str:
    """Return the bucket policy (JSON): everybody may read assets and collections by name, and list nothing."""
    statement = {
        "Sid": "ReadAssetsAndCollections",
        "Effect": "Allow",
        "Principal": {"AWS": ["*"]},
        "Action": ["s3:GetObject"],
        "Resource": [f"arn:aws:s3:::{bucket}/{prefix}*" for prefix in PUBLIC_PREFIXES],
    }
    return json.dumps({"Version": "2012-10-17", "Statement": [statement]})


def main() -> None:
    """Create the bucket and set its policy. Idempotent: run it before the services at every start."""
    from services.storage.s3 import S3Store

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        settings = StorageSettings()
        store = open_store(settings)
        if not isinstance(store, S3Store):
            _log.info("a local store needs no bucket")
            return
        store.create_bucket()
        if settings.presign_s:
            store.close_to_strangers()
            store.let_pages_read()
        else:
            store.set_policy(read_policy(settings.bucket))
    except (OSError, SettingsError) as error:
        sys.exit(f"bucket: {error}")
    readable = "nothing: the gateway presigns" if settings.presign_s else ", ".join(PUBLIC_PREFIXES)
    _log.info("bucket %s is ready; whoever reaches it may read %s", settings.bucket, readable)


if __name__ == "__main__":
    main()
