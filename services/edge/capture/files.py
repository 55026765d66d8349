"""List and read the files of a capture without ever opening anything outside of its folder.

Symbolic links are skipped, and a path in a capture's file that leads out of the folder (path traversal) is an error.
"""

from __future__ import annotations

import json
import os
import posixpath
import re
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.capture.text_encoding import decode_text
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.order.reading import AS_IT_SEEMS, FileReading
from capture2vr.sentences.sentence import say

MAX_FILES = 20_000  # a minute of LiDAR at 60 frames/s with three files each is 10,800
MAX_DEPTH = 6  # levels of folders below the capture's root that are listed
_ANYWHERE = "/"  # no file's folder is called so
MAX_TEXT_BYTES = 256 * 2**20  # of a JSON or CSV; no phone's recording has a larger one


@contextmanager
def translate_errors(file: str, what: str) -> Iterator[None]:
    """Translate every exception of a parser into CAPTURE_UNREADABLE, naming the file; `what` is its kind."""
    try:
        yield
    except (CaptureError, Cancelled):
        raise
    except MemoryError:
        raise CaptureError("CAPTURE_TOO_LARGE", say("not_enough_memory_to_read", what=what), file=file) from None
    except Exception as error:  # noqa: BLE001 - parsers raise anything at all on hostile bytes
        text = error.strerror if isinstance(error, OSError) else str(error)  # str(OSError) has the server's own paths
        reason = " ".join((text or "").split())[:200] or type(error).__name__
        raise unreadable(file, say("not_readable", what=what, reason=reason)) from None


def unreadable(file: str, reason: str, *hints: str) -> CaptureError:
    """Return a CAPTURE_UNREADABLE error for a file whose content is not what its name or header says."""
    return CaptureError("CAPTURE_UNREADABLE", reason, file=file, hints=hints or (say("export_capture_again"),))


def truncated(file: str, reason: str) -> CaptureError:
    """Return a CAPTURE_TRUNCATED error: the file is shorter than its own header says."""
    return CaptureError("CAPTURE_TRUNCATED", reason, file=file, hints=(say("copy_export_file_again"),))


def number_order(name: str) -> tuple[tuple[int, str], ...]:
    """Return a sort key for natural order: frame_2 comes before frame_10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name))


@dataclass(frozen=True, slots=True)
class Folder:
    """A capture's folder. `names` are the relative paths of its files, with forward slashes, in natural order.

    tick is called during reads that take seconds, and may raise Cancelled; reading: what a person says of the files.
    """

    root: Path
    names: tuple[str, ...]
    tick: Tick = field(default=no_tick, repr=False, compare=False)
    reading: FileReading = AS_IT_SEEMS
    _known: frozenset[str] = field(init=False, repr=False, compare=False)
    _by_end: dict[tuple[str, str], str] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_known", frozenset(self.names))  # thousands of frames are looked up by name
        object.__setattr__(self, "_by_end", _first_by_end(self.names))

    def path(self, name: str) -> Path:
        return self.root / name

    def has(self, name: str) -> bool:
        return name in self._known

    def exists(self, name: str) -> bool:
        """Return whether a regular file of this name exists inside the folder, even if `names` does not list it."""
        place = self.path(name).resolve()
        return place.is_file() and place.is_relative_to(self.root.resolve())

    def directly_in(self, folder: str, *suffixes: str) -> list[str]:
        """Return the names of the files directly in `folder` ("" is the root), optionally only with these suffixes."""
        found = (name for name in self.names if posixpath.dirname(name) == folder)
        return [name for name in found if not suffixes or name.lower().endswith(suffixes)]

    def has_folder(self, folder: str) -> bool:
        return any(name.startswith(folder + "/") for name in self.names)

    def resolve(self, written: object, *, by: str, base: str = "") -> str:
        """Resolve a relative path `written` in the file `by`, from the folder `base`: return its name in the capture.

        Raises CAPTURE_UNREADABLE for a path that leads out of the capture's folder.
        """
        if not isinstance(written, str) or not written or "\0" in written:
            raise unreadable(by, say("has_where_name_file_expected", written=repr(written))[:200])
        text = written.replace("\\", "/")
        name = posixpath.normpath(posixpath.join(base, text))
        if text.startswith("/") or re.match(r"[A-Za-z]:", text) or name.startswith("../") or name in ("..", "."):
            reason = say("refers_to_outside_capture_folder", name=repr(written[:120]))
            raise unreadable(by, reason, say("put_file_into_capture_folder"))
        return name

    def find(self, written: str, *, by: str) -> str | None:
        """Return the name of the file that is `written` in the file `by`, relative to that, or None.

        Where it is not there, as programs write paths of their own machine: that of a file of its name in the capture.
        Raises CAPTURE_UNREADABLE for a path out of the capture's folder, unless the capture has a file of its name.
        """
        written, beside, outside = written.strip().strip('"'), posixpath.dirname(by), None
        try:
            name = self.resolve(written, by=by, base=beside)
            if self.exists(name):
                return name
        except CaptureError as error:
            outside = error
        last = _look_up(posixpath.basename(written.replace("\\", "/")))
        found = self._by_end.get((beside, last)) or self._by_end.get((_ANYWHERE, last))
        if found is None and outside is not None:
            raise outside
        return found


def _first_by_end(names: tuple[str, ...]) -> dict[tuple[str, str], str]:
    """Map (folder, file name as it is looked up) to the first name like this; the folder is also _ANYWHERE.

    A hostile file refers to a hundred thousand others: so a look-up must not go through all names.
    """
    found: dict[tuple[str, str], str] = {}
    for name in sorted(names):
        place, last = posixpath.split(name)
        found.setdefault((place, _look_up(last)), name)
        found.setdefault((_ANYWHERE, _look_up(last)), name)
    return found


def _look_up(name: str) -> str:
    """Return a file's name as it is looked up: in any case, with its accents composed or not."""
    return unicodedata.normalize("NFC", name).lower()


def open_folder(root: Path) -> Folder:
    """List the regular files below `root`, without hidden files, `__MACOSX` and symbolic links.

    Raises CAPTURE_TOO_LARGE above MAX_FILES.
    """
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
                raise CaptureError("CAPTURE_TOO_LARGE", say("capture_has_more_than_files", most=MAX_FILES))


def read_text(path: Path, name: str) -> str:
    """Read a text file in its encoding; bytes that are no characters become replacement characters."""
    with translate_errors(name, "text file"):
        if path.stat().st_size > MAX_TEXT_BYTES:
            reason = say("text_file_more_than_mib", size=MAX_TEXT_BYTES // 2**20)
            raise CaptureError("CAPTURE_TOO_LARGE", reason, file=name)
        return decode_text(path.read_bytes())


def data_lines(text: str) -> list[str]:
    """Return the lines that are neither empty nor comments, which begin with #."""
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def read_json(path: Path, name: str) -> dict[str, Any]:
    """Read a JSON file whose top level is an object."""
    return parse_json(read_text(path, name), name)


def parse_json(text: str, name: str) -> dict[str, Any]:
    """Parse a JSON text whose top level is an object; `name` is the file for errors."""
    with translate_errors(name, "JSON file"):
        value = json.loads(text)
    if not isinstance(value, dict):
        raise unreadable(name, say("json_file_but_top_level"))
    return value


def numbers(value: object, count: int, *, file: str, what: str) -> Floats:
    """Convert nested JSON lists or text fields to (count,) float64. NaN passes: the caller has to check for it."""
    with translate_errors(file, f"list of numbers ({what})"):
        flat = np.asarray(value, np.float64).reshape(-1)
    if len(flat) != count:
        raise unreadable(file, say("has_numbers_in_expected", numbers=len(flat), what=what, count=count))
    return flat


def number(record: Mapping[str, Any], key: str, *, file: str) -> float:
    """Return the number under a required key of a JSON object."""
    if key not in record:
        raise unreadable(file, say("has_no_value", key=repr(key)))
    return float(numbers(record[key], 1, file=file, what=key)[0])
