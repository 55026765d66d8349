"""Streams the body of an upload to disk: multipart/form-data, one raw zip, or one file.

The body comes from a request, or from the store, where a resumable upload has kept it.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect, Request

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.uploads.file_names import safe_name, unique_name
from capture2vr.gateway.uploads.refusal import SEND_FEWER, too_many_files
from capture2vr.sentences.sentence import say

# Bytes per write in a thread: 32 uploads hold 8 MB, and switching threads costs 1 % of the write.
_BATCH_BYTES = 256 << 10
_IDLE_S = 60.0  # timeout without a byte: mobile networks pause for some seconds only
_FIELD_BYTES = 1024  # most bytes of a text field
_MOST_FIELDS = 20  # text fields of a form
_FORM_TYPE = b"multipart/form-data"
_ZIP_TYPES = (b"application/zip", b"application/x-zip-compressed", b"application/octet-stream")

InThread = Callable[[Callable[[], None]], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """Limits of an upload: total_bytes of all files together, and the number of files."""

    total_bytes: int
    files: int


@dataclass(frozen=True, slots=True)
class UploadBody:
    """The bytes of an upload, and what is told of them.

    batches     the bytes, in parts of some 256 KB
    media_type  their Content-Type
    size        how many they are; 0: not told
    file_name   name of the one file that they are; "": a form, or a zip without a name
    fields      text fields that are told beside the bytes
    """

    batches: AsyncIterator[bytes]
    media_type: str
    size: int = 0
    file_name: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class ReceivedUpload:
    """The received files, by their safe relative names below `folder`, and text fields by name.

    has_client_names  whether the files' names are those of the client: the file of a raw body has none
    """

    folder: Path
    files: list[str] = field(default_factory=list)
    fields: dict[str, str] = field(default_factory=dict)
    size: int = 0
    has_client_names: bool = True


def body_of(request: Request) -> UploadBody:
    """Return the body of a request."""
    length = request.headers.get("content-length", "")
    size = int(length) if length.isascii() and length.isdigit() else 0
    return UploadBody(batches(request), request.headers.get("content-type", ""), size)


async def receive(body: UploadBody, folder: Path, limits: UploadLimits, in_thread: InThread) -> ReceivedUpload:
    """Write the files in a body below `folder`. Raises Problem 400, 408, 413, 415; Refused; ClientDisconnect."""
    sink = _sink(body, ReceivedUpload(folder, fields=dict(body.fields)), limits)
    try:
        async for batch in body.batches:
            await in_thread(functools.partial(sink.write, batch))
        await in_thread(sink.finish)
    finally:
        sink.close()
    return sink.received


async def batches(request: Request) -> AsyncIterator[bytes]:
    """Yield a request's body in batches of at least `_BATCH_BYTES`.

    Raises Problem 408 when the client stops sending, ClientDisconnect when it leaves; the bytes before have been
    yielded then.
    """
    batch = bytearray()
    stream = aiter(request.stream())
    failure: Exception | None = None
    while failure is None:
        try:
            async with asyncio.timeout(_IDLE_S):
                batch += await anext(stream)
        except (StopAsyncIteration, ClientDisconnect) as end:
            failure = end
        except TimeoutError:
            detail = say("client_sent_nothing_s", seconds=_IDLE_S)
            failure = Problem(408, "UPLOAD_SILENT", detail, retryable=True)
        if len(batch) >= _BATCH_BYTES or (failure and batch):
            yield bytes(batch)
            batch.clear()
    if not isinstance(failure, StopAsyncIteration):
        raise failure


def require_media_type(media_type: str, file_name: str) -> None:
    """Raises Problem 415 for a body that is neither a form, nor a zip, nor a file with a name."""
    kind, options = parse_options_header(media_type)
    is_form = kind == _FORM_TYPE and options.get(b"boundary")
    if not (is_form or file_name or kind in _ZIP_TYPES):
        raise Problem(
            415,
            "UPLOAD_MEDIA_TYPE",
            "the Content-Type of an upload must be multipart/form-data with a boundary, or application/zip",
            hints=("send the files as fields named 'files'",),
        )


def _sink(body: UploadBody, received: ReceivedUpload, limits: UploadLimits) -> _OneFile | _MultipartBody:
    """Return the writer for a body. Raises Problem 415."""
    require_media_type(body.media_type, body.file_name)
    if body.file_name:
        return _OneFile(safe_name(body.file_name) or "file", received, limits)
    kind, options = parse_options_header(body.media_type)
    if kind == _FORM_TYPE:
        return _MultipartBody(options[b"boundary"], received, limits)
    received.has_client_names = False
    return _OneFile("capture.zip", received, limits)


class _UploadFiles:
    """Writes the files of an upload one after the other, and enforces the limits."""

    def __init__(self, received: ReceivedUpload, limits: UploadLimits) -> None:
        self.received = received
        self._limits = limits
        self._used_names: dict[str, int] = {}
        self._file: BinaryIO | None = None

    def open(self, name: str) -> None:
        if len(self.received.files) >= self._limits.files:
            raise too_many_files(self._limits.files)
        name = unique_name(name, self._used_names)
        path = self.received.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except (FileExistsError, NotADirectoryError, IsADirectoryError):
            hints = (say("rename_file_folder"),)
            raise Problem(400, "UPLOAD_NAMES", say("file_folder_have_same_name"), file=name, hints=hints) from None
        self.received.files.append(name)

    def write(self, data: bytes) -> None:
        self.received.size += len(data)
        if self.received.size > self._limits.total_bytes:
            detail = say("upload_too_large_most_bytes", most=self._limits.total_bytes)
            raise Problem(413, "UPLOAD_TOO_LARGE", detail, hints=SEND_FEWER)
        if self._file is not None:
            self._file.write(data)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


class _OneFile:
    """Receives a body that is one file."""

    def __init__(self, name: str, received: ReceivedUpload, limits: UploadLimits) -> None:
        self.received = received
        self._name = name
        self._files = _UploadFiles(received, limits)

    def write(self, data: bytes) -> None:
        if not self.received.files:
            self._files.open(self._name)
        self._files.write(data)

    def finish(self) -> None:
        self.close()

    def close(self) -> None:
        self._files.close()


class _MultipartBody:
    """Receives a multipart form: parts with a file name are files, the others are text fields."""

    def __init__(self, boundary: bytes, received: ReceivedUpload, limits: UploadLimits) -> None:
        self.received = received
        self._files = _UploadFiles(received, limits)
        self._limits = limits
        self._parts, self._most_parts = 0, limits.files + _MOST_FIELDS
        self._headers: dict[str, bytes] = {}
        self._header_name = self._header_value = b""
        self._text: bytearray | None = None
        self._text_name = ""
        self._ended = False
        self._parser = self._make_parser(boundary)

    def write(self, data: bytes) -> None:
        try:
            self._parser.write(data)
        except FormParserError:
            raise _malformed() from None

    def finish(self) -> None:
        if not self._ended:
            raise _malformed()
        self.close()

    def close(self) -> None:
        self._files.close()

    def _make_parser(self, boundary: bytes) -> MultipartParser:
        try:
            return MultipartParser(
                boundary,
                {
                    "on_part_begin": self._on_part_begin,
                    "on_header_field": self._on_header_field,
                    "on_header_value": self._on_header_value,
                    "on_header_end": self._on_header_end,
                    "on_headers_finished": self._on_headers_finished,
                    "on_part_data": self._on_part_data,
                    "on_part_end": self._on_part_end,
                    "on_end": self._on_end,
                },
            )
        except FormParserError:
            raise _malformed() from None

    def _on_part_begin(self) -> None:
        self._headers = {}
        self._parts += 1
        if self._parts > self._most_parts:
            raise too_many_files(self._limits.files)

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _on_header_end(self) -> None:
        self._headers[self._header_name.decode("latin-1").lower()] = self._header_value
        self._header_name = self._header_value = b""

    def _on_headers_finished(self) -> None:
        disposition = self._headers.get("content-disposition", b"").decode("latin-1")
        _, options = parse_options_header(disposition)
        if b"filename" not in options:
            self._text, self._text_name = bytearray(), options.get(b"name", b"").decode("utf-8", "replace")
            return
        name = safe_name(options[b"filename"].decode("utf-8", "replace"))
        if name:  # empty: a form field without a file, or a file to be skipped such as .DS_Store
            self._files.open(name)

    def _on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._text is None:
            self._files.write(data[start:end])
            return
        self._text += data[start:end]
        if len(self._text) > _FIELD_BYTES:
            detail = f"a text field of the form is too large; at most {_FIELD_BYTES:,} bytes are allowed"
            raise Problem(413, "UPLOAD_FIELD_TOO_LARGE", detail, hints=(say("send_files_with_file_name"),))

    def _on_part_end(self) -> None:
        if self._text is not None:
            self.received.fields[self._text_name] = self._text.decode("utf-8", "replace")
        self._text = None
        self._files.close()

    def _on_end(self) -> None:
        self._ended = True


def _malformed() -> Problem:
    return Problem(
        400,
        "UPLOAD_MALFORMED",
        say("multipart_form_malformed_incomplete"),
        retryable=True,
        hints=(say("send_again_connection_may"),),
    )
