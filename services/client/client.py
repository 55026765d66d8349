"""`Client`: a gateway from Python, as the command line uses it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Unpack

from capture2vr.client.answers import paged, parse_answer
from capture2vr.client.assets import ListedAsset, assets_of
from capture2vr.client.download import download
from capture2vr.client.http import client_of, reaching
from capture2vr.client.jobs import JOB_TIMEOUT, create_job, follow, raise_unless_succeeded
from capture2vr.client.keep import keep_version
from capture2vr.client.names import check_collection, check_id, check_key
from capture2vr.client.nouns import JobProgress, RemoteJob, StoredCapture, UploadProgress
from capture2vr.client.pull import PulledAsset, pull
from capture2vr.client.upload import require_capture, upload
from capture2vr.order.job_fields import JobFields, box_of, options_of
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION

_PAGE = 200  # jobs per request: the gateway's maximum
_Path = str | os.PathLike[str]


def _ignore(progress: UploadProgress) -> None:
    """Do nothing: the progress callback of a caller that shows none."""


class Client:
    """A client of one gateway: upload captures, start and follow jobs, pull assets.

    Use it in one thread at a time, and close it at the end, or with `with`. Methods raise GatewayError where the
    gateway refuses or cannot be reached, and BadInput for an argument that cannot be right.

    >>> with capture2vr.Client(gateway.url) as client:
    ...     capture = client.upload(folder / "sphere.npy")
    ...     job = client.wait(client.start(capture, "sphere"))
    ...     pulled = client.pull("sphere", folder / "sphere")
    >>> job.state, pulled.version == job.version
    ('SUCCEEDED', True)
    """

    def __init__(self, gateway: str = "http://127.0.0.1:8080", *, key: str | None = None) -> None:
        """Open no connection yet. Raises BadInput for a key that cannot be sent, GatewayError for a URL that is none.

        gateway  its URL
        key      access key, "c2v_TENANT_…"; None: the one in CAPTURE2VR_KEY, if there is one
        """
        self.gateway = gateway.rstrip("/")
        with reaching(self.gateway):
            self._http = client_of(self.gateway, key=key, timeout=JOB_TIMEOUT, follow_redirects=True)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def upload(
        self,
        path: _Path,
        *,
        box: Sequence[float | str] | None = None,
        progress: Callable[[UploadProgress], None] = _ignore,
    ) -> StoredCapture:
        """Upload a capture: a file, a folder or a zip; return what the gateway has stored.

        One of 16 MB and more goes on where it stopped after a lost connection, a restart of the gateway, or when the
        same is uploaded again.

        box       left, top, right, bottom of the object in a photo, or x, y on it, in shares of its sides, and
                  perhaps the photo's name
        progress  called with each UploadProgress

        >>> client.upload(folder / "sphere.npy", progress=lambda each: None).kind
        'points'
        """
        source = Path(path)
        require_capture(source)
        with reaching(self.gateway):
            return StoredCapture.of(upload(self._http, source, _Listener(progress), box=box_of(box)))

    def start(self, capture: StoredCapture | str, key: str, **fields: Unpack[JobFields]) -> RemoteJob:
        """Start a job that makes an asset of a capture, and return it; it runs whether somebody follows it or not.

        capture  what `upload` returned, or its id
        key      of the asset, by which VR clients find it; the same key again makes its next version
        fields   options of the job: preset, label, cut, target, … (`JobFields` lists them)

        >>> client.start(capture, "ball", label="A ball").asset_key
        'ball'
        """
        check_key(key)
        options = options_of(fields)
        if options.collection:
            check_collection(options.collection)
        request = {"asset_key": key, "label": key, **options.given}
        with reaching(self.gateway):
            return RemoteJob.of(create_job(self._http, "/v1/jobs", request, _id_of(capture)))

    def job(self, job: RemoteJob | str) -> RemoteJob:
        """Return a job as it is now.

        >>> client.job(job).has_ended
        True
        """
        return self._job(job)

    def jobs(self) -> Iterator[RemoteJob]:
        """Yield all jobs, the newest first.

        >>> job.id in {each.id for each in client.jobs()}
        True
        """
        with reaching(self.gateway):
            yield from paged(self._http, "/v1/jobs", "jobs", {"limit": _PAGE}, RemoteJob.of)

    def follow(self, job: RemoteJob | str) -> Iterator[JobProgress]:
        """Yield the events of a job, those so far first, until it has ended; reconnects where a connection is lost.

        A job that fails ends the iteration as one that succeeds: the last event's `state` tells.

        >>> [each.published for each in client.follow(job) if each.published][:1]
        ['preview']
        """
        with reaching(self.gateway):
            yield from map(JobProgress.of, follow(self._http, _id_of(job)))

    def wait(self, job: RemoteJob | str, *, progress: Callable[[JobProgress], None] | None = None) -> RemoteJob:
        """Wait until a job has ended, and return it. Raises JobFailed, with the reason, where it made no asset.

        progress  called with each event

        >>> client.wait(job).state
        'SUCCEEDED'
        """
        for event in self.follow(job):
            if progress:
                progress(event)
        with reaching(self.gateway):
            ended = parse_answer(self._http.get(f"/v1/jobs/{_id_of(job)}"))
        raise_unless_succeeded(ended)
        return RemoteJob.of(ended)

    def cancel(self, job: RemoteJob | str) -> RemoteJob:
        """Cancel a job: at once while it waits, within seconds while it runs; nothing where it has ended.

        >>> client.cancel(job).state
        'SUCCEEDED'
        """
        return self._job(job, "/cancel")

    def assets(self, collection: str = DEFAULT_COLLECTION, *, label: str = "") -> Iterator[ListedAsset]:
        """Yield the assets of a collection, sorted by key. label: a part of theirs, or one of their search words

        >>> "sphere" in {each.key for each in client.assets()}
        True
        """
        check_collection(collection)
        with reaching(self.gateway):
            yield from assets_of(self._http, collection, {"label": label} if label else {})

    def keep(self, key: str, *, version: int | None = None) -> int:
        """Publish a version that was held back because its grade says to shoot again, and return its new number.

        version  its number, such as that of the job; None: the newest that is held back

        >>> client.keep("sphere")
        Traceback (most recent call last):
            ...
        capture2vr.errors.BadInput: ...
        """
        with reaching(self.gateway):
            return keep_version(self._http, key, version)

    def pull(
        self,
        key: str,
        folder: _Path,
        *,
        collection: str = "",
        trusted: Sequence[_Path] = (),
        cache: _Path | None = None,
    ) -> PulledAsset:
        """Download the newest version of an asset into a folder, all of it or nothing.

        Every hash is checked, from the collection down; with a public key also the signature, and that the collection
        is not older than the newest that this machine has seen. Files of an earlier pull are replaced.

        collection  the one that lists the asset; "": the first that the gateway names
        trusted     files of public keys (PEM); none: those in STORAGE_TRUSTED_KEYS
        cache       folder; None: $XDG_CACHE_HOME/capture2vr or ~/.cache/capture2vr

        Raises VerificationError where the asset is not what was signed, or a part of it is missing or damaged; `folder`
        is then unchanged. BadInput where a file of somebody else would be replaced.

        >>> client.pull("sphere", folder / "sphere").manifest["key"]
        'sphere'
        """
        keys, place = tuple(map(Path, trusted)), None if cache is None else Path(cache)
        with reaching(self.gateway):
            return pull(self._http, self.gateway, key, Path(folder), collection=collection, trusted=keys, cache=place)

    def download(
        self, key: str, format_name: str = "glb", out: _Path | None = None, *, version: int | None = None
    ) -> Path:
        """Download an asset as one file in the format of another program; the gateway makes it if need be.

        format_name  "glb", "usdz", "obj", "stl", … (`capture2vr download --help` lists them)
        out          file or existing folder; None: named by the key, in the current folder
        version      number of an earlier version; None: the current one

        >>> client.download("sphere", "pdf", folder)
        Traceback (most recent call last):
            ...
        capture2vr.errors.GatewayError: ...
        """
        with reaching(self.gateway):
            return download(self._http, key, format_name, None if out is None else Path(out), version=version)

    def _job(self, job: RemoteJob | str, verb: str = "") -> RemoteJob:
        path = f"/v1/jobs/{_id_of(job)}{verb}"
        with reaching(self.gateway):
            return RemoteJob.of(parse_answer(self._http.post(path) if verb else self._http.get(path)))


class _Listener:
    """The `Report` of a caller's function."""

    def __init__(self, progress: Callable[[UploadProgress], None]) -> None:
        self._progress = progress

    def show(self, stage: str, fraction: float, message: str = "") -> None:
        self._progress(UploadProgress(stage, fraction, message))

    def warn(self, text: str) -> None:
        self._progress(UploadProgress("UPLOADING", 0.0, text))


def _id_of(thing: RemoteJob | StoredCapture | str) -> str:
    """Return an id. Raises BadInput for a text that is none: dots and slashes in it would lead to another address."""
    return check_id(thing if isinstance(thing, str) else thing.id)
