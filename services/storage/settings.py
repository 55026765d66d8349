"""Settings of the object store and its signing keys, from the environment variables STORAGE_*."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, SecretStr
from pydantic_settings import SettingsConfigDict

from capture2vr.process.strict_settings import CommaList, SettingsError, StrictSettings
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION, valid_key
from capture2vr.storage.catalogue.publish import PublishPolicy
from capture2vr.storage.catalogue.signing import KeyFileError, Keys, read_public_key, read_signer
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store

_ENDPOINT = re.compile(r"https?://[^\s/?#]+(/[^\s?#]*)?")
_BUCKET = re.compile(r"[A-Za-z0-9._-]{1,255}|arn:[^\s]+", re.ASCII)


def _check_endpoint(url: str) -> str:
    if url and not _ENDPOINT.fullmatch(url):
        raise ValueError("give a URL, such as http://store:9000 or https://s3.example")
    return url


def _check_bucket(name: str) -> str:
    if not _BUCKET.fullmatch(name):
        raise ValueError("use letters, digits, . _ - for a bucket's name, or the ARN of an access point")
    return name


def _check_collection_name(name: str) -> str:
    if not valid_key(name):
        raise ValueError("use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit")
    return name


class StorageSettings(StrictSettings):
    """Settings of the store. kind `local` needs only a root; `s3` needs a bucket and, outside AWS, an endpoint.

    public_endpoint  URL under which clients reach the S3 service, where no base_url is set
    base_url         prefix of the objects' URLs that clients get: a CDN, or the gateway's /v1/files
    presign_s        with S3: seconds for which the gateway lets clients read an object of a private bucket, by a signed
                     URL; 0: clients read at base_url, and what stands there guards what is private
    secret_key_file  file that holds the secret key, read where secret_key is empty
    collection       collection of assets for which nobody named one
    signing_key      files of private keys (PEM) that sign collections: one, two during a key rotation; none: unsigned
    trusted_keys     files of public keys (PEM) whose signatures are accepted, besides those of signing_key; with
                     neither, any collection is accepted
    """

    model_config = SettingsConfigDict(env_prefix="STORAGE_")

    kind: Literal["local", "s3"] = "local"
    root: Path = Path("data/objects")
    base_url: str = ""
    endpoint: Annotated[str, AfterValidator(_check_endpoint)] = ""
    public_endpoint: Annotated[str, AfterValidator(_check_endpoint)] = ""
    bucket: Annotated[str, AfterValidator(_check_bucket)] = "capture2vr"
    region: str = "us-east-1"
    presign_s: Annotated[int, Field(ge=0, le=7 * 86_400)] = 0  # S3 signs for a week at most
    access_key: SecretStr = SecretStr("")
    secret_key: SecretStr = SecretStr("")
    secret_key_file: Path | None = None
    collection: Annotated[str, AfterValidator(_check_collection_name)] = DEFAULT_COLLECTION
    signing_key: CommaList = ()
    trusted_keys: CommaList = ()


def open_store(settings: StorageSettings) -> Store:
    """Create the store that the settings name; it connects at first use.

    Raises SettingsError where only one of access key and secret key is set, or the secret key's file cannot be read.
    """
    if settings.kind == "local":
        return LocalStore(settings.root, settings.base_url or "/v1/files")
    access, secret = settings.access_key.get_secret_value(), _secret_key(settings)
    if bool(access) != bool(secret):
        raise SettingsError("only one of STORAGE_ACCESS_KEY and STORAGE_SECRET_KEY is set: set both or neither")
    return _open_s3(settings, access, secret)


def _secret_key(settings: StorageSettings) -> str:
    if (secret := settings.secret_key.get_secret_value()) or settings.secret_key_file is None:
        return secret
    try:
        return settings.secret_key_file.read_text().strip()
    except OSError as error:
        raise SettingsError(f"STORAGE_SECRET_KEY_FILE: {error}") from None


def open_keys(settings: StorageSettings) -> Keys:
    """Read the signing and trusted keys. Raises SettingsError that names the variable and the file at fault."""
    try:
        variable = "STORAGE_SIGNING_KEY"
        signers = tuple(read_signer(Path(path)) for path in settings.signing_key)
        variable = "STORAGE_TRUSTED_KEYS"
        return Keys(signers, tuple(read_public_key(Path(path)) for path in settings.trusted_keys))
    except KeyFileError as error:
        raise SettingsError(f"{variable}: {error}") from None


def open_policy(settings: StorageSettings) -> PublishPolicy:
    """Return the policy by which workers publish: they sign with these settings' keys, and never list an asset of
    another collection in a second one. Raises SettingsError.
    """
    return PublishPolicy(open_keys(settings), allow_other_collections=False)


def _open_s3(settings: StorageSettings, access: str, secret: str) -> Store:
    from capture2vr.storage.s3 import S3Store  # here, because importing boto3 takes 0.2 s, which a local store saves

    return S3Store(
        bucket=settings.bucket,
        access_key=access,
        secret_key=secret,
        endpoint=settings.endpoint,
        public_endpoint=settings.public_endpoint,
        region=settings.region,
        base_url="/v1/files" if settings.presign_s else settings.base_url,
        presign_s=settings.presign_s,
    )
