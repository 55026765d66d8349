"""The files of a capture: what is there, safely named, safely read.

Nothing outside the capture's folder is ever opened: symbolic links are left out, and a path written inside a capture
that leaves the folder is refused by name.
"""

from __future__ import annotations

import json
import os
import posixpath
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from services.edge.arrays import Floats, Tick, no_tick
from services.edge.errors import Cancelled, CaptureError

MAX_FILES = 20_000  # a minute of LiDAR at 60 frames/s with three files each is 10,800
MAX_DEPTH = 6  # folders below the capture's root that are looked into
MAX_TEXT_BYTES = 256 * 2**20  # a JSON or CSV above this describes no phone's recording


@contextmanager
def reading(file: str, what: str) -> Iterator[None]:
    """Translate whatever a parser throws at hostile bytes into CAPTURE_UNREADABLE, naming the file."""
    try:
        yield
    except (CaptureError, Cancelled):
        raise
    except MemoryError:
        raise CaptureError("CAPTURE_TOO_LARGE", f"not enough memory to read this {what}", file=file) from None
    except Exception as error:  # noqa: BLE001 - parsers raise anything at all on hostile bytes; here is where it gets its name
        said = error.strerror if isinstance(error, OSError) else str(error)  # an OSError would tell our own paths
        reason = " ".join((said or "").split())[:200] or type(error).__name__
        raise unreadable(file, f"is not a readable {what} ({reason})") from None


def unreadable(file: str, reason: str, *hints: str) -> CaptureError:
    """A file that is not what its name or header says."""
    return CaptureError("CAPTURE_UNREADABLE", reason, file=file, hints=hints or ("export the capture again",))


def number_order(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key under which frame_2 comes before frame_10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name))


@dataclass(frozen=True, slots=True)
class Folder:
    """A capture's folder: `names` are the regular files in it, relative, with forward slashes, in number order.

    tick is called while something that takes seconds is read, and may raise Cancelled.
    """

    root: Path
    names: tuple[str, ...]
    tick: Tick = field(default=no_tick, repr=False, compare=False)
    _known: frozenset[str] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_known", frozenset(self.names))  # thousands of frames are looked up by name

    def path(self, name: str) -> Path:
        return self.root / name

    def has(self, name: str) -> bool:
        return name in self._known

    def finds(self, name: str) -> bool:
        """Whether a regular file of this name lies inside the folder, also one that `names` does not list."""
        place = self.path(name).resolve()
        return place.is_file() and place.is_relative_to(self.root.resolve())

    def directly_in(self, folder: str, *suffixes: str) -> list[str]:
        """Names of the files directly in `folder` ("" is the root), optionally only with these suffixes."""
        found = (name for name in self.names if posixpath.dirname(name) == folder)
        return [name for name in found if not suffixes or name.lower().endswith(suffixes)]

    def has_folder(self, folder: str) -> bool:
        return any(name.startswith(folder + "/") for name in self.names)

    def inside(self, written: object, *, by: str, base: str = "") -> str:
        """The name for a path `written` in the file `by`; CAPTURE_UNREADABLE when it leaves the folder."""
        if not isinstance(written, str) or not written or "\0" in written:
            raise unreadable(by, f"names a file by {written!r}"[:200])
        text = written.replace("\\", "/")
        name = posixpath.normpath(posixpath.join(base, text))
        if text.startswith("/") or re.match(r"[A-Za-z]:", text) or name.startswith("../") or name in ("..", "."):
            raise unreadable(by, f"names {written[:120]!r}, which lies outside the capture", "use relative paths")
        return name


def open_folder(root: Path) -> Folder:
    """List the regular files below `root`; hidden files, `__MACOSX` and symbolic links are left out."""
    names: list[str] = []
    _list(root, "", MAX_DEPTH, names)
    return Folder(root, tuple(sorted(names, key=number_order)))


def _list(folder: Path, prefix: str, depth: int, names: list[str]) -> None:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(".") or entry.name == "__MACOSX":
                continue
            if entry.is_dir(follow_symlinks=False) and depth:
                _list(folder / entry.name, f"{prefix}{entry.name}/", depth - 1, names)
            elif entry.is_file(follow_symlinks=False):
                names.append(prefix + entry.name)
            if len(names) > MAX_FILES:
                raise CaptureError("CAPTURE_TOO_LARGE", f"the capture holds more than {MAX_FILES:,} files")


def read_text(path: Path, name: str) -> str:
    """A text file, UTF-8 with or without a byte order mark; bytes that are not UTF-8 become replacement characters."""
    with reading(name, "text"):
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise CaptureError("CAPTURE_TOO_LARGE", f"is over {MAX_TEXT_BYTES // 2**20} MiB of text", file=name)
        return path.read_bytes().decode("utf-8-sig", errors="replace")


def read_json(path: Path, name: str) -> dict[str, Any]:
    """A JSON object."""
    return parse_json(read_text(path, name), name)


def parse_json(text: str, name: str) -> dict[str, Any]:
    with reading(name, "JSON file"):
        value = json.loads(text)
    if not isinstance(value, dict):
        raise unreadable(name, "is JSON, but not an object")
    return value


def numbers(value: object, count: int, *, file: str, what: str) -> Floats:
    """(count,) float64 from nested JSON lists or text fields; NaN passes, it is the caller's to judge."""
    with reading(file, f"list of numbers ({what})"):
        flat = np.asarray(value, np.float64).reshape(-1)
    if len(flat) != count:
        raise unreadable(file, f"{what} has {len(flat)} numbers, expected {count}")
    return flat


def number(record: Mapping[str, Any], key: str, *, file: str) -> float:
    """A required number of a JSON object."""
    if key not in record:
        raise unreadable(file, f"has no {key!r}")
    return float(numbers(record[key], 1, file=file, what=key)[0])
