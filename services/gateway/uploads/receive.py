"""The body of an upload, streamed to disk as it comes: multipart/form-data, or one raw zip."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from services.gateway.errors import Problem
from services.gateway.uploads.names import safe_name, unique_name

_BATCH_BYTES = (
    256 << 10
)  # handed to a thread at once: 32 uploads hold 8 MB, and a thread's switch costs 1 % of the write
_IDLE_S = 60.0  # a phone that sends nothing for so long has gone; mobile networks pause for some seconds
_FIELD_BYTES = 1024  # of a text field
_MOST_FIELDS = 20
_FEWER = ("send fewer frames, for example every second one",)

InThread = Callable[[Callable[[], None]], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class UploadLimits:
    """bytes of all files together, and the number of files."""

    total_bytes: int
    files: int


@dataclass(slots=True)
class Received:
    """Files by their safe relative names, below `folder`; text fields by name.

    named  whether the names are the client's: a raw body has none
    """

    folder: Path
    files: list[str] = field(default_factory=list)
    fields: dict[str, str] = field(default_factory=dict)
    size: int = 0
    named: bool = True


async def receive(request: Request, folder: Path, limits: UploadLimits, in_thread: InThread) -> Received:
    """Write the request's files below `folder`. Raises Problem 400, 408, 413 or 415; ClientDisconnect."""
    sink = _sink(request, Received(folder), limits)
    try:
        async for batch in _batches(request):
            await in_thread(functools.partial(sink.write, batch))
        await in_thread(sink.finish)
    finally:
        sink.close()
    return sink.received


async def _batches(request: Request) -> AsyncIterator[bytes]:
    """The body in pieces worth a thread's while. Raises Problem 408 for a client that falls silent."""
    batch = bytearray()
    stream = aiter(request.stream())
    while True:
        try:
            async with asyncio.timeout(_IDLE_S):
                batch += await anext(stream)
        except StopAsyncIteration:
            break
        except TimeoutError:
            raise Problem(408, "UPLOAD_SILENT", f"nothing came for {_IDLE_S:.0f} s", retryable=True) from None
        if len(batch) >= _BATCH_BYTES:
            yield bytes(batch)
            batch.clear()
    if batch:
        yield bytes(batch)


def _sink(request: Request, received: Received, limits: UploadLimits) -> _Raw | _Multipart:
    kind, options = parse_options_header(request.headers.get("content-type"))
    if kind == b"multipart/form-data" and options.get(b"boundary"):
        return _Multipart(options[b"boundary"], received, limits)
    if kind in (b"application/zip", b"application/x-zip-compressed", b"application/octet-stream"):
        return _Raw(received, limits)
    raise Problem(
        415,
        "UPLOAD_MEDIA_TYPE",
        "an upload is multipart/form-data with a boundary, or one application/zip",
        hints=("send the files as fields named 'files'",),
    )


class _Files:
    """Writes one file after the other and keeps to the limits."""

    def __init__(self, received: Received, limits: UploadLimits) -> None:
        self.received = received
        self._limits = limits
        self._taken: dict[str, int] = {}
        self._file: BinaryIO | None = None

    def open(self, name: str) -> None:
        if len(self.received.files) >= self._limits.files:
            raise too_many_files(self._limits)
        name = unique_name(name, self._taken)
        path = self.received.folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        except (FileExistsError, NotADirectoryError, IsADirectoryError):
            hints = ("rename one of them",)
            raise Problem(
                400, "UPLOAD_NAMES", "a file and a folder have the same name", file=name, hints=hints
            ) from None
        self.received.files.append(name)

    def write(self, data: bytes) -> None:
        self.received.size += len(data)
        if self.received.size > self._limits.total_bytes:
            detail = f"an upload may have {self._limits.total_bytes:,} bytes"
            raise Problem(413, "UPLOAD_TOO_LARGE", detail, hints=_FEWER)
        if self._file is not None:
            self._file.write(data)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


class _Raw:
    """The whole body is one zip."""

    def __init__(self, received: Received, limits: UploadLimits) -> None:
        self.received = received
        self.received.named = False
        self._files = _Files(received, limits)

    def write(self, data: bytes) -> None:
        if not self.received.files:
            self._files.open("capture.zip")
        self._files.write(data)

    def finish(self) -> None:
        self.close()

    def close(self) -> None:
        self._files.close()


class _Multipart:
    """A form: parts with a file name are files, the others are text fields."""

    def __init__(self, boundary: bytes, received: Received, limits: UploadLimits) -> None:
        self.received = received
        self._files = _Files(received, limits)
        self._limits = limits
        self._parts, self._most_parts = 0, limits.files + _MOST_FIELDS
        self._headers: dict[str, bytes] = {}
        self._header_name = self._header_value = b""
        self._text: bytearray | None = None
        self._text_name = ""
        self._ended = False
        self._parser = self._made_parser(boundary)

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

    def _made_parser(self, boundary: bytes) -> MultipartParser:
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
            raise too_many_files(self._limits)

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
        if name:  # nameless: a field of the form without a file, or one that nobody meant to send
            self._files.open(name)

    def _on_part_data(self, data: bytes, start: int, end: int) -> None:
        if self._text is None:
            self._files.write(data[start:end])
            return
        self._text += data[start:end]
        if len(self._text) > _FIELD_BYTES:
            detail = f"a text field may have {_FIELD_BYTES:,} bytes"
            raise Problem(413, "UPLOAD_FIELD_TOO_LARGE", detail, hints=("send files with their names",))

    def _on_part_end(self) -> None:
        if self._text is not None:
            self.received.fields[self._text_name] = self._text.decode("utf-8", "replace")
        self._text = None
        self._files.close()

    def _on_end(self) -> None:
        self._ended = True


def too_many_files(limits: UploadLimits) -> Problem:
    """What an upload of more files is told, however they came."""
    return Problem(413, "UPLOAD_TOO_MANY_FILES", f"an upload may have {limits.files:,} files", hints=_FEWER)


def _malformed() -> Problem:
    return Problem(
        400,
        "UPLOAD_MALFORMED",
        "the form is malformed or ends too early",
        retryable=True,
        hints=("the connection may have broken: send it again",),
    )
