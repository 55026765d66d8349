"""`python -m capture2vr.storage.bucket`: create the S3 bucket; make `assets/` and `collections/` readable by everybody.

Headsets read these two without credentials and check them by signature and hash. Captures, catalogue entries and
aliases stay private. With STORAGE_PRESIGN_S everything stays private, and the gateway presigns what somebody may read.
A service that is still starting is waited for.
"""

from __future__ import annotations

import json
import logging
import sys
import time

from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.s3 import S3Store
from capture2vr.storage.settings import StorageSettings, open_store

_log = logging.getLogger(__name__)

PUBLIC_PREFIXES = ("assets/", "collections/", "tenants/*/assets/", "tenants/*/collections/")
"""Objects that the edge cache reads without credentials; who may read them through it, the gateway says."""

WAIT_S = 120.0
"""Seconds that a service gets to start: some take up to a minute on a busy machine."""

_PAUSE_S = 1.0


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


def _create_bucket(store: S3Store) -> None:
    """Create the bucket; try again while the service does not answer or has an error. Raises OSError after WAIT_S."""
    deadline, has_told = time.monotonic() + WAIT_S, False
    while True:
        try:
            return store.create_bucket()
        except PermissionError:  # waiting does not make a key right
            raise
        except OSError as error:
            if time.monotonic() > deadline:
                raise
            if not has_told:
                _log.info("waiting for the store: %s", error)
            has_told = True
        time.sleep(_PAUSE_S)


def main() -> None:
    """Create the bucket and set its policy. Idempotent: run it before the services at every start."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        settings = StorageSettings()
        store = open_store(settings)
        if not isinstance(store, S3Store):
            _log.info("a local store needs no bucket")
            return
        _create_bucket(store)
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
