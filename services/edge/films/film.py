"""Read a video without poses (mp4, mov, webm): its key frames become photos, which one camera of unknown lens took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from capture2vr.edge.capture.files import Folder, translate_errors, unreadable
from capture2vr.edge.capture.nouns import MIN_PHOTOS, WALK_AROUND_ADVICE, Capture, Photo
from capture2vr.edge.capture.panorama import ALL_SIDES, VIEWS, by_direction, split
from capture2vr.edge.capture.photos import MAX_PHOTOS, evenly_spaced, pictures
from capture2vr.edge.capture.picture import first_bytes
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.films.film_scan import DEADLINE_S, SKIP, VideoScan, scan_video
from capture2vr.edge.films.keyframes import key_frames, swept_share
from capture2vr.edge.films.video import CACHED_PX, VideoFrames, VideoPixels
from capture2vr.edge.films.video_streams import container_of
from capture2vr.sentences.sentence import say

_SPHERE_PX = 2560  # width of frames of all sides: 5 MB each in the cache, from which each of 8 views is cut
_MOST_SWEPT = 0.25  # of the key frames that were taken while the picture moved fast; fewer are outvoted by the others
_WALK = say("walk_around_thing_while_you")


def find_videos(folder: Folder) -> list[str]:
    """Return the files that have a video's magic number, largest first."""
    others = set(pictures(folder))
    found = [name for name in folder.names if name not in others and container_of(first_bytes(folder.path(name), name))]
    return sorted(found, key=lambda name: -folder.path(name).stat().st_size)


def unused_warning(names: Sequence[str]) -> tuple[str, ...]:
    """Return a warning about videos that were not read; none for an empty list."""
    if not names:
        return ()
    return (
        say("not_used", name=names[0]) if len(names) == 1 else say("videos_not_used", count=len(names), name=names[0]),
    )


def read(folder: Folder) -> Capture:
    """Read the largest video of the folder. Raises what `read_film` raises.

    The frames of a video of all sides are split into views, as panoramas are.
    """
    name, *others = find_videos(folder)
    film = read_film(folder, name)
    if film.all_sides:
        whole = evenly_spaced(film.photos, MAX_PHOTOS // VIEWS)
        views = by_direction([split(photo, ALL_SIDES, level=False) for photo in whole])
        told = say("video_of_all_sides_split", name=name, count=len(whole), views=VIEWS)
        film = replace(film, photos=tuple(views), warnings=(told, *film.warnings))
    beside = len(pictures(folder))
    few = (say("photos_beside_not_used_least", count=beside, name=name, least=MIN_PHOTOS),) if beside else ()
    return Capture("photos", "video", photos=film.photos, warnings=(*film.warnings, *unused_warning(others), *few))


@dataclass(frozen=True, slots=True)
class Film:
    """Key frames of a video as photos, in their order, with their frame numbers in the video, and warnings.

    all_sides: whether they are panoramas
    """

    photos: tuple[Photo, ...]
    numbers: tuple[int, ...]
    warnings: tuple[str, ...]
    all_sides: bool = False


def read_film(folder: Folder, name: str) -> Film:
    """Select the key frames of a video in one pass over it, and return them as photos that decode lazily.

    Raises CAPTURE_LOW_OVERLAP when hardly anything moves, CAPTURE_EMPTY, CAPTURE_UNREADABLE, CAPTURE_TOO_LARGE and
    IMAGE_TOO_LARGE.
    """
    path = folder.path(name)
    with translate_errors(name, "video"):
        scan = scan_video(path, name, folder.tick)
        chosen = key_frames(scan.frames)
    stamps = [frame.stamp for frame in chosen]
    if len(stamps) < MIN_PHOTOS:
        raise _too_few_frames(scan, name)
    if scan.sphere == "other":
        raise unreadable(name, say("video_of_all_sides_not_read"), say("export_video_as_equirectangular"))
    all_sides, size = scan.sphere is not None, scan.stream.size
    if all_sides and size[0] > _SPHERE_PX:
        size = _SPHERE_PX, round(size[1] * _SPHERE_PX / size[0])
    frames = VideoFrames(path, name, cached=stamps, skip=SKIP, cached_px=_SPHERE_PX if all_sides else CACHED_PX)
    camera = f"{name}, {size[0]} x {size[1]}"
    photos = tuple(
        Photo(_photo_name(name, scan.seconds(stamp)), size, camera, VideoPixels(frames, stamp, size), turns=scan.turns)
        for stamp in stamps
    )
    swept = 0.0 if all_sides else swept_share(chosen)
    bent = (say("video_swept", name=name, share=swept),) if swept > _MOST_SWEPT else ()
    return Film(photos, tuple(map(scan.index.stamps.index, stamps)), (*scan.faults(name), *bent), all_sides)


def _photo_name(name: str, seconds: float) -> str:
    return f"{name} at {seconds:.2f} s"


def _too_few_frames(scan: VideoScan, name: str) -> CaptureError:
    """Return the error for a video without enough key frames: too slow, undecodable, too short, or without movement."""
    count = len(scan.frames)
    if scan.late and count < MIN_PHOTOS:
        reason = say("takes_too_long_to_decode_only_pictures", count=count, seconds=DEADLINE_S)
        return CaptureError("CAPTURE_TOO_LARGE", reason, file=name, hints=(say("film_in_1920_x_1080"),))
    if count < MIN_PHOTOS:
        damaged = scan.broken_s is not None or not count
        reason = say("damaged_cannot_be_decoded") if damaged else say("too_short_has_only_frames", count=count)
        return unreadable(name, reason, say("copy_from_phone_again_film"))
    reason = say("shows_thing_from_one_side", seconds=scan.end_s)
    return CaptureError(
        "CAPTURE_LOW_OVERLAP", reason, file=name, hints=(_WALK, say("or_advice", advice=WALK_AROUND_ADVICE))
    )
