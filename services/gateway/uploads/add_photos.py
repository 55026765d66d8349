"""Add the photos of an upload to those of an earlier capture: what a check process does with a capture that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from capture2vr.gateway.uploads.file_names import unique_name
from capture2vr.gateway.uploads.refusal import Refused, too_many_files
from capture2vr.gateway.uploads.sniff import HEAD_BYTES, IMAGES, Kind, sniff
from capture2vr.sentences.sentence import say

_ALLOWED = IMAGES | {Kind.UNKNOWN, Kind.RAW, Kind.SIDECAR}  # these are left out, as in any upload


def add_photos(source: Path, names: Sequence[str], earlier: Path, earlier_names: Sequence[str], most: int) -> list[str]:
    """Move the files in `source` to those in `earlier`, and return the names of all, relative to `earlier`.

    The earlier files keep their names; a new one gets a number where its name is taken.

    most  files that a capture may have

    Raises Refused CAPTURE_NOT_PHOTOS, UPLOAD_TOO_MANY_FILES.
    """
    for name in earlier_names:
        _require_photo(earlier / name, say("capture_to_be_continued"), name, IMAGES)
    for name in names:
        _require_photo(source / name, "the upload", name, _ALLOWED)
    if len(names) + len(earlier_names) > most:
        raise too_many_files(most)
    used = {part.casefold(): 2 for name in earlier_names for part in PurePosixPath(name).parts}
    added = []
    for name in names:
        own = unique_name(PurePosixPath(name).name, used)
        (source / name).rename(earlier / own)
        added.append(own)
    return [*earlier_names, *added]


def _require_photo(path: Path, where: str, name: str, allowed: set[Kind]) -> None:
    with path.open("rb") as file:
        kind = sniff(name, file.read(HEAD_BYTES))
    if kind not in allowed:
        detail = say("has_file_no_photo", where=where)
        raise Refused("CAPTURE_NOT_PHOTOS", detail, name, (say("send_all_files_again"),))
