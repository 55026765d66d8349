"""Which store a service uses, from the variables STORAGE_*."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import SecretStr
from pydantic_settings import SettingsConfigDict

from services.storage.local import LocalStore
from services.storage.store import Store
from services.strict_settings import SettingsError, StrictSettings


class StorageSettings(StrictSettings):
    """`local` needs only a root; `s3` needs a bucket and, outside AWS, an endpoint.

    public_endpoint  the S3 service as clients reach it; presigned URLs are signed for this host
    base_url         what stands before an object's name in the URLs that clients get: a CDN, or the gateway's /v1/files
    """

    model_config = SettingsConfigDict(env_prefix="STORAGE_")

    kind: Literal["local", "s3"] = "local"
    root: Path = Path("data/objects")
    base_url: str = ""
    endpoint: str = ""
    public_endpoint: str = ""
    bucket: str = "capture2vr"
    region: str = "us-east-1"
    access_key: SecretStr = SecretStr("")
    secret_key: SecretStr = SecretStr("")


def open_store(settings: StorageSettings) -> Store:
    """The store of these settings; it connects when it is first used. Raises SettingsError for half a pair of keys."""
    if settings.kind == "local":
        return LocalStore(settings.root, settings.base_url or "/v1/files")
    access, secret = settings.access_key.get_secret_value(), settings.secret_key.get_secret_value()
    if bool(access) != bool(secret):
        raise SettingsError("STORAGE_ACCESS_KEY and STORAGE_SECRET_KEY go together: set both or none")
    return _open_s3(settings, access, secret)


def _open_s3(settings: StorageSettings, access: str, secret: str) -> Store:
    from services.storage.s3 import S3Store  # boto3 takes 0.2 s to import, which a local store need not pay

    return S3Store(
        bucket=settings.bucket,
        access_key=access,
        secret_key=secret,
        endpoint=settings.endpoint,
        public_endpoint=settings.public_endpoint,
        region=settings.region,
        base_url=settings.base_url,
    )
