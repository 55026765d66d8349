"""`python -m services.storage.bucket`: make the bucket and let anybody read `assets/`, nothing else.

Assets carry their sha256 in their names and are meant for any headset; captures and catalogues stay with the services.
"""

from __future__ import annotations

import json
import logging
import sys

from services.storage.settings import StorageSettings, open_store
from services.strict_settings import SettingsError

_log = logging.getLogger(__name__)

PUBLIC_PREFIX = "assets/"


def read_policy(bucket: str) -> str:
    """The bucket policy (JSON) under which anybody may get an asset by its name, and list nothing."""
    statement = {
        "Sid": "ReadAssets",
        "Effect": "Allow",
        "Principal": {"AWS": ["*"]},
        "Action": ["s3:GetObject"],
        "Resource": [f"arn:aws:s3:::{bucket}/{PUBLIC_PREFIX}*"],
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
    _log.info("bucket %s is ready; %s is readable by anybody", settings.bucket, PUBLIC_PREFIX)


if __name__ == "__main__":
    main()
