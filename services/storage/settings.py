"""Which store a service uses, from the variables STORAGE_*."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, SecretStr
from pydantic_settings import SettingsConfigDict

from services.storage.catalogue import DEFAULT_COLLECTION, valid_key
from services.storage.local import LocalStore
from services.storage.publish import Publish, publish
from services.storage.signing import KeyFileError, Keys, read_public, read_signer
from services.storage.store import Store
from services.strict_settings import CommaList, SettingsError, StrictSettings


def _collection(name: str) -> str:
    if not valid_key(name):
        raise ValueError("use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit")
    return name


class StorageSettings(StrictSettings):
    """`local` needs only a root; `s3` needs a bucket and, outside AWS, an endpoint.

    public_endpoint  the S3 service as clients reach it; presigned URLs are signed for this host
    base_url         what stands before an object's name in the URLs that clients get: a CDN, or the gateway's /v1/files
    collection       which collection is entered by what nobody named one for
    signing_key      private keys (PEM) that sign collections; one, or two while they are exchanged; none: unsigned
    trusted_keys     public keys (PEM) whose collections are believed, besides those of signing_key; none: anybody's
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
    collection: Annotated[str, AfterValidator(_collection)] = DEFAULT_COLLECTION
    signing_key: CommaList = ()
    trusted_keys: CommaList = ()


def open_store(settings: StorageSettings) -> Store:
    """The store of these settings; it connects when it is first used. Raises SettingsError for half a pair of keys."""
    if settings.kind == "local":
        return LocalStore(settings.root, settings.base_url or "/v1/files")
    access, secret = settings.access_key.get_secret_value(), settings.secret_key.get_secret_value()
    if bool(access) != bool(secret):
        raise SettingsError("STORAGE_ACCESS_KEY and STORAGE_SECRET_KEY go together: set both or none")
    return _open_s3(settings, access, secret)


def open_keys(settings: StorageSettings) -> Keys:
    """The keys of these settings. Raises SettingsError that names the variable and the file at fault."""
    try:
        variable = "STORAGE_SIGNING_KEY"
        signers = tuple(read_signer(Path(path)) for path in settings.signing_key)
        variable = "STORAGE_TRUSTED_KEYS"
        return Keys(signers, tuple(read_public(Path(path)) for path in settings.trusted_keys))
    except KeyFileError as error:
        raise SettingsError(f"{variable}: {error}") from None


def open_publish(settings: StorageSettings) -> Publish:
    """`publish` for those who publish for others: signed with these settings' keys, each asset in its own collection.

    Raises SettingsError.
    """
    return partial(publish, keys=open_keys(settings), joins=False)


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
