"""An object store on any S3-compatible service: AWS, MinIO, SeaweedFS, R2, ..."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import boto3
from boto3.s3.transfer import TransferConfig
from botocore.config import Config
from botocore.exceptions import BotoCoreError, ClientError, HTTPClientError
from botocore.exceptions import ConnectionError as BotoConnectionError

from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.store import IMMUTABLE, ConditionFailed, Head, check_name

_MULTIPART_BYTES = 16 << 20  # larger files go in parts; below, one request is faster. S3's smallest part is 5 MiB
_TRANSFER = TransferConfig(
    multipart_threshold=_MULTIPART_BYTES, multipart_chunksize=_MULTIPART_BYTES, max_concurrency=4
)
_CONNECT_S, _READ_S = 5.0, 60.0  # timeouts: a healthy endpoint accepts in ms; a slow one may need seconds to answer
_ATTEMPTS = 5  # boto's standard mode: exponential back-off with jitter, up to 20 s each
_CONNECTIONS = 32  # pool size: the number of simultaneous uploads that the gateway promises
_CLOCK_CODES = {"RequestTimeTooSkewed", "RequestExpired"}  # a signature is good for a quarter of an hour
_LIST_LIMIT = 1000  # objects per page: S3 lists no more at once


class S3Store:
    """The objects of one bucket, addressed path-style (no wildcard DNS needed).

    endpoint         where this process reaches the service; "" for AWS
    public_endpoint  where clients reach the service. Default: endpoint
    base_url         where clients read objects, e.g. a CDN in front of the bucket. Default: public_endpoint/bucket
    presign_s        seconds for which presigned URLs are good; 0: there are none, because others guard what is private
    """

    def __init__(
        self,
        *,
        bucket: str,
        access_key: str = "",
        secret_key: str = "",
        endpoint: str = "",
        public_endpoint: str = "",
        region: str = "us-east-1",
        base_url: str = "",
        presign_s: int = 0,
    ) -> None:
        self._bucket = bucket
        # AWS makes a bucket outside us-east-1 only where the request names the region; others know no regions.
        is_named = _is_aws(endpoint) and region != "us-east-1"
        self._place = {"CreateBucketConfiguration": {"LocationConstraint": region}} if is_named else {}
        self._presign_s = presign_s
        # A signature covers the host that clients ask.
        self._signing = _client(public_endpoint or endpoint, access_key, secret_key, region) if presign_s else None
        self._client = _client(endpoint, access_key, secret_key, region)
        service_url = (public_endpoint or endpoint).rstrip("/") or f"https://s3.{region}.amazonaws.com"
        self._base_url = base_url.rstrip("/") or f"{service_url}/{bucket}"

    def create_bucket(self) -> None:
        """Create the bucket unless it exists."""
        with _translate_errors(self._bucket):
            try:
                self._client.head_bucket(Bucket=self._bucket)
            except ClientError as error:
                if _status(error) != 404:
                    raise
                self._client.create_bucket(Bucket=self._bucket, **self._place)

    def set_policy(self, policy: str) -> None:
        """Replace the bucket's policy (JSON): who may read what without credentials."""
        with _translate_errors(self._bucket):
            self._client.put_bucket_policy(Bucket=self._bucket, Policy=policy)

    def let_pages_read(self) -> None:
        """Set the bucket's CORS rules: pages of any origin may GET objects that they are allowed to read."""
        rule = {
            "AllowedOrigins": ["*"],
            "AllowedMethods": ["GET", "HEAD"],
            "AllowedHeaders": ["*"],
            "ExposeHeaders": ["ETag", "Content-Length", "Content-Range"],
        }
        with _translate_errors(self._bucket):
            self._client.put_bucket_cors(Bucket=self._bucket, CORSConfiguration={"CORSRules": [rule]})

    def close_to_strangers(self) -> None:
        """Delete the bucket's policy: nobody reads it without credentials or a presigned URL."""
        with _translate_errors(self._bucket):
            try:
                self._client.delete_bucket_policy(Bucket=self._bucket)
            except ClientError as error:
                if error.response["Error"].get("Code") != "NoSuchBucketPolicy":  # AWS takes none for deleted
                    raise

    def put(
        self,
        name: str,
        data: bytes | Path,
        *,
        content_type: str,
        cache_control: str = IMMUTABLE,
        if_match: str | None = None,
        if_absent: bool = False,
        link: bool = False,
    ) -> Head:
        headers = {"ContentType": content_type, "CacheControl": cache_control}
        size = data.stat().st_size if isinstance(data, Path) else len(data)
        condition = _condition_arguments(if_match, if_absent)
        with _translate_errors(check_name(name)):
            if isinstance(data, Path) and size > _MULTIPART_BYTES and not condition:
                self._client.upload_file(str(data), self._bucket, name, ExtraArgs=headers, Config=_TRANSFER)
                return self.head(name)
            answer = self._put_object(name, data, headers | condition)
        date = answer["ResponseMetadata"]["HTTPHeaders"].get("date")
        modified = parsedate_to_datetime(date) if date else datetime.now(UTC)
        return Head(name, size, _unquote(answer["ETag"]), content_type, cache_control, modified)

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        if length == 0:
            self.head(name)
            return b""
        bounds = {"Range": f"bytes={start}-{'' if length is None else start + length - 1}"} if start or length else {}
        with _translate_errors(check_name(name)):
            try:
                body: bytes = self._client.get_object(Bucket=self._bucket, Key=name, **bounds)["Body"].read()
            except ClientError as error:
                if _status(error) == 416:  # the range begins behind the end
                    return b""
                raise
        return body

    def fetch(self, name: str, path: Path) -> None:
        """Download an object in parallel parts into a temporary file, then rename that to `path`."""
        neighbour = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
        with atomic_write(path, temporary=neighbour, durable=False) as part, _translate_errors(check_name(name)):
            self._client.download_file(self._bucket, name, str(part), Config=_TRANSFER)

    def head(self, name: str) -> Head:
        with _translate_errors(check_name(name)):
            answer = self._client.head_object(Bucket=self._bucket, Key=name)
        return Head(
            name,
            answer["ContentLength"],
            _unquote(answer["ETag"]),
            answer.get("ContentType", ""),
            answer.get("CacheControl", ""),
            answer["LastModified"],
        )

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        heads: list[Head] = []
        while len(heads) < limit:
            page = min(limit - len(heads), _LIST_LIMIT)
            with _translate_errors(self._bucket):
                answer = self._client.list_objects_v2(
                    Bucket=self._bucket, Prefix=prefix, StartAfter=after, MaxKeys=page
                )
            found = [
                Head(each["Key"], each["Size"], _unquote(each["ETag"]), "", "", each["LastModified"])
                for each in answer.get("Contents", ())
            ]
            heads += found
            if not answer["IsTruncated"] or not found:
                break
            after = found[-1].name
        return heads

    def delete(self, name: str) -> None:
        with _translate_errors(check_name(name)):
            self._client.delete_object(Bucket=self._bucket, Key=name)

    def url(self, name: str) -> str:
        return f"{self._base_url}/{quote(check_name(name))}"

    def presigned_url(self, name: str) -> str:
        """Return a URL that reads the object for some minutes; browsers keep the answer as long, and no cache in
        between. "" where presign_s is 0.
        """
        if self._signing is None:
            return ""
        asked = {
            "Bucket": self._bucket,
            "Key": check_name(name),
            "ResponseCacheControl": f"private, max-age={self._presign_s}",
        }
        return str(self._signing.generate_presigned_url("get_object", Params=asked, ExpiresIn=self._presign_s))

    def _put_object(self, name: str, data: bytes | Path, arguments: dict[str, str]) -> dict[str, Any]:
        with data.open("rb") if isinstance(data, Path) else nullcontext(data) as body:
            answer: dict[str, Any] = self._client.put_object(Bucket=self._bucket, Key=name, Body=body, **arguments)
        return answer


def _client(endpoint: str, access_key: str, secret_key: str, region: str) -> Any:
    # Not boto3's default session, which is not thread-safe while it creates clients.
    return boto3.session.Session().client(
        "s3",
        endpoint_url=endpoint or None,
        aws_access_key_id=access_key or None,
        aws_secret_access_key=secret_key or None,
        region_name=region,
        config=Config(
            signature_version="s3v4",
            s3={"addressing_style": "path"},
            # The newer default sends trailing checksums in chunked encoding, which fails through TLS proxies and on
            # several S3 servers.
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
            retries={"mode": "standard", "total_max_attempts": _ATTEMPTS},
            connect_timeout=_CONNECT_S,
            read_timeout=_READ_S,
            max_pool_connections=_CONNECTIONS,
        ),
    )


def _is_aws(endpoint: str) -> bool:
    return not endpoint or (urlsplit(endpoint).hostname or "").endswith(".amazonaws.com")


def _condition_arguments(if_match: str | None, if_absent: bool) -> dict[str, str]:
    # The etag is sent without quotes: some servers compare the header literally with their own unquoted etag, so a
    # quoted one never matches. MinIO and AWS accept both.
    matching = {"IfMatch": if_match} if if_match is not None else {}
    return matching | ({"IfNoneMatch": "*"} if if_absent else {})


@contextmanager
def _translate_errors(name: str) -> Iterator[None]:
    """Translate botocore's errors into built-in ones."""
    try:
        yield
    except ClientError as error:
        raise _builtin_error(name, error) from None
    except (BotoConnectionError, HTTPClientError) as error:
        raise OSError(f"the S3 service cannot be reached for {name}: {error}") from None
    except (BotoCoreError, boto3.exceptions.Boto3Error) as error:
        raise _unwrap(name, error) from None


def _builtin_error(name: str, error: ClientError) -> Exception:
    status, code = _status(error), str(error.response.get("Error", {}).get("Code", ""))
    if code == "NoSuchBucket":
        return OSError(f"the bucket of {name} does not exist; create it with python -m capture2vr.storage.bucket")
    if status == 404:
        # AWS answers a conditional put of a missing object with 404, others with 412.
        return ConditionFailed(f"{name} is gone") if error.operation_name == "PutObject" else FileNotFoundError(name)
    if status == 412 or code == "ConditionalRequestConflict":
        return ConditionFailed(f"{name} has changed")
    if code in _CLOCK_CODES:
        return PermissionError(
            f"the S3 service denies {error.operation_name} of {name}: {code}; this machine's clock is wrong: set it"
        )
    if status in (401, 403):
        return PermissionError(
            f"the S3 service denies {error.operation_name} of {name}: {code}; check STORAGE_ACCESS_KEY"
        )
    return OSError(f"the S3 service failed at {error.operation_name} of {name}: {status} {code}")


def _unwrap(name: str, error: Exception) -> Exception:
    """Translate an error of boto3's transfers, which wrap the ClientError that says what happened."""
    cause = error.__context__
    return _builtin_error(name, cause) if isinstance(cause, ClientError) else OSError(f"{name}: {error}")


def _status(error: ClientError) -> int:
    return int(error.response.get("ResponseMetadata", {}).get("HTTPStatusCode", 0))


def _unquote(etag: str) -> str:
    return etag.strip('"')
