"""A film alone: mp4, mov, webm. Its key frames, chosen in one pass at a small size, are photos like any others.

Nothing is known of the lens, and all key frames share it: one camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from services.edge.capture.files import Folder, reading, unreadable
from services.edge.capture.keyframes import key_frames
from services.edge.capture.nouns import AROUND, MIN_PHOTOS, Capture, Photo
from services.edge.capture.photos import pictures
from services.edge.capture.picture import first_bytes
from services.edge.capture.streams import container_of
from services.edge.capture.video import VideoFrames, VideoPixels
from services.edge.capture.viewing import DEADLINE_S, SKIP, Viewing, view
from services.edge.errors import CaptureError

_WALK = "walk around the thing while you film, slowly and all the way, with textured things beside it"


def videos(folder: Folder) -> list[str]:
    """Files that are videos by their bytes, the largest first."""
    others = set(pictures(folder))
    found = [name for name in folder.names if name not in others and container_of(first_bytes(folder.path(name), name))]
    return sorted(found, key=lambda name: -folder.path(name).stat().st_size)


def unused(names: Sequence[str]) -> tuple[str, ...]:
    """A sentence about videos beside what was read."""
    if not names:
        return ()
    return (f"{names[0]} was not used" if len(names) == 1 else f"{len(names)} videos were not used: {names[0]}, ...",)


def read(folder: Folder) -> Capture:
    """The largest video's key frames. Raises what `read_film` raises."""
    name, *others = videos(folder)
    film = read_film(folder, name)
    beside = len(pictures(folder))
    few = (f"{beside} photos beside {name} were not used: at least {MIN_PHOTOS} are needed",) if beside else ()
    return Capture("photos", "video", photos=film.photos, warnings=(*film.warnings, *unused(others), *few))


@dataclass(frozen=True, slots=True)
class Film:
    """A film's key frames as photos, in their order, and their numbers among all of its frames."""

    photos: tuple[Photo, ...]
    numbers: tuple[int, ...]
    warnings: tuple[str, ...]


def read_film(folder: Folder, name: str) -> Film:
    """Raises CAPTURE_LOW_OVERLAP where nothing moves, CAPTURE_EMPTY, CAPTURE_UNREADABLE and IMAGE_TOO_LARGE."""
    path = folder.path(name)
    with reading(name, "video"):
        seen = view(path, name, folder.tick)
        stamps = [look.stamp for look in key_frames(seen.looks)]
    if len(stamps) < MIN_PHOTOS:
        raise _too_little(seen, name)
    size, frames = seen.stream.size, VideoFrames(path, name, kept=stamps, skip=SKIP)
    camera = f"{name}, {size[0]} x {size[1]}"
    photos = tuple(
        Photo(_at(name, seen.seconds(stamp)), size, camera, VideoPixels(frames, stamp, size), turns=seen.turns)
        for stamp in stamps
    )
    return Film(photos, tuple(map(seen.table.stamps.index, stamps)), seen.faults(name))


def _at(name: str, seconds: float) -> str:
    return f"{name} at {seconds:.2f} s"


def _too_little(seen: Viewing, name: str) -> CaptureError:
    """Few frames, or none that move."""
    count = len(seen.looks)
    if seen.late and count < MIN_PHOTOS:
        reason = f"takes too long to decode: {count} pictures in {DEADLINE_S:.0f} s"
        return CaptureError("CAPTURE_TOO_LARGE", reason, file=name, hints=("film in 1920 x 1080",))
    if count < MIN_PHOTOS:
        said = "cannot be decoded" if seen.broken_s is not None or not count else f"holds {count} frames"
        return unreadable(name, said, "copy it from the phone again, or film for 20 seconds")
    reason = f"shows the thing from one side: in {seen.end_s:.0f} s hardly anything moves"
    return CaptureError("CAPTURE_LOW_OVERLAP", reason, file=name, hints=(_WALK, f"or {AROUND}"))
