"""Capture → points: the first half of the method, with photos turned into depth first. A worker may send the points to
another worker, which does the second half."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, field, replace

from capture2vr.edge.arrays import Floats, Tick, no_tick, part_of
from capture2vr.edge.capture.facts import CaptureFacts
from capture2vr.edge.capture.nouns import FEW_PHOTOS, Capture, CaptureKind, Frame
from capture2vr.edge.closing.close_object import close_object
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.coverage import unseen_sides
from capture2vr.edge.fusion.fuse import FusedPoints, fuse, has_stereo_depth
from capture2vr.edge.fusion.fuse_scene import fuse_scene
from capture2vr.edge.fusion.orbit import require_aim, sees_a_scene, sure_aim
from capture2vr.edge.fusion.points_of_frames import points_of_frames
from capture2vr.edge.fusion.texture_views import hold_out_frames, texture_view
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.generated.to_points import generated_points, require_one_photo
from capture2vr.edge.marking.isolate_marked import isolate_marked, what_to_keep, with_marked_photo
from capture2vr.edge.marking.marked_object import Mark
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.odometry.posed_frames import with_poses
from capture2vr.edge.photos.depth_maps import at_texture_resolution
from capture2vr.edge.points.clean_cloud import cloud_points
from capture2vr.edge.points.edit import cut_away, set_frame
from capture2vr.edge.points.flatness import flatness_warning
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.points.isolate import IsolatedObject, isolate_object
from capture2vr.edge.points.lasso import require_photos
from capture2vr.edge.points.nouns import CutReport, Points, TextureView
from capture2vr.edge.points.scale import scale_to_longest
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.edge.single_photo.complete_back import complete_back
from capture2vr.edge.single_photo.few_photos import depth_or_guess, guess_instead
from capture2vr.edge.single_photo.to_points import to_points as guess_points
from capture2vr.order.job_options import DEFAULT_OPTIONS, JobOptions
from capture2vr.order.option_table import Cut, Fill
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

# Fraction of the progress up to the preview at which each stage begins; measured on a 10,000-point cloud and on an
# RGB-D room, on two cores.
STARTS = {"VALIDATING": 0.0, "POINT_CLOUD": 0.05, "FITTING": 0.25}
# The same for photos, which have to become depth images first: that takes longer than all the rest.
PHOTO_STARTS = {"VALIDATING": 0.0, "ALIGNING": 0.01, "POINT_CLOUD": 0.62, "FITTING": 0.7}

PREVIEW_SHARE = 0.15
"""Fraction of the whole progress bar that the preview takes, where a training follows it."""

_ALL_WANTED = CutReport("scene", say("everything_asked"))
_POSES = 0.5  # share of the time to the points that computing poses takes, for frames without any

_CLOSING = 0.97
"""Share of the time to an object's points at which what it lacks is closed."""

_PHOTO_PREVIEW_SHARE = 0.6  # the same for photos, whose depth images take most of the time


@dataclass(frozen=True, slots=True)
class PreparedPoints:
    """Points ready for fitting a field, with a summary of their capture and the seconds that each stage took."""

    points: Points
    source: CaptureFacts
    seconds: Mapping[str, float] = field(default_factory=dict)


def preview_share(kind: CaptureKind) -> float:
    """Fraction of the progress bar that points and preview take together, where a training follows."""
    return _PHOTO_PREVIEW_SHARE if kind == "photos" else PREVIEW_SHARE


def prepare(
    capture: Capture,
    bar: Bar,
    options: JobOptions = DEFAULT_OPTIONS,
    *,
    refines: bool,
    device: str = "cpu",
    hold_out: int | None = None,
    models: ModelFolder | None = None,
    generator: GeneratorServer | None = None,
) -> Generator[Progress, None, PreparedPoints]:
    """Make the points of a capture, and move `bar` to where fitting begins. Arguments and errors as of `reconstruct`.

    options    of the job; here count its cut, longest_m, box and edits
    refines    whether a training may follow the preview
    models     learned models that may help
    generator  makes the object; None: it is made from the capture
    """
    if generator is not None:
        require_one_photo(capture)
    options = replace(options, box=with_marked_photo(capture, options.box))
    require_photos(capture, options.edits.lassos)
    clock = Clock()
    starts = PHOTO_STARTS if capture.kind == "photos" else STARTS
    bar.set_range(starts, 0.0, preview_share(capture.kind) if refines else 1.0)
    source, given = CaptureFacts.of(capture, generated=generator is not None), capture
    if capture.kind == "photos":
        yield bar.begin("ALIGNING", say("count_photos", count=len(capture.photos)))
        with clock("ALIGNING"):
            tick = bar.tick("ALIGNING")
            capture = depth_or_guess(capture, box=options.box, models=models, device=device, tick=tick)
    yield bar.begin("POINT_CLOUD", say("generator_works") if generator else say("reading_format", format=source.format))
    with clock("POINT_CLOUD"):
        if generator:
            tick = bar.tick("POINT_CLOUD")
            points = generated_points(capture, generator, box=options.box, models=models, tick=tick)
        else:
            capture, points = _points_or_guess(given, capture, options, hold_out, models, bar)
        if given.kind == "photos":
            source = replace(source, kind="image" if capture.kind == "image" else "photos", verdicts=capture.verdicts)
        if options.longest_m:  # it was measured before anything was cut away
            points = scale_to_longest(points, options.longest_m)
        points = cut_away(points, options.edits, part_of(bar.tick("POINT_CLOUD"), 1.0, 1.0))
        points = set_frame(points, options.edits)
        points = replace(
            points,
            texture_views=tuple(map(_at_texture_resolution, points.texture_views)),
            held_out_views=tuple(map(_at_texture_resolution, points.held_out_views)),
            scene_views=tuple(map(_at_texture_resolution, points.scene_views)),
        )
    bar.advance("POINT_CLOUD", 1.0)
    return PreparedPoints(points, source, clock.seconds)


def _at_texture_resolution(view: TextureView) -> TextureView:
    return replace(view, load_rgb=at_texture_resolution(view.load_rgb))


def _points_or_guess(
    given: Capture, capture: Capture, options: JobOptions, hold_out: int | None, models: ModelFolder | None, bar: Bar
) -> tuple[Capture, Points]:
    """Make points of a capture; where depth of few photos gives none, of the relief of one of the photos `given`."""
    try:
        return capture, _points(capture, options, hold_out, models, bar)
    except CaptureError as error:
        guess = guess_instead(given, error, box=options.box, models=models)
        return guess, _points(guess, options, hold_out, models, bar)


def _points(
    capture: Capture, options: JobOptions, hold_out: int | None, models: ModelFolder | None, bar: Bar
) -> Points:
    if capture.kind == "image":
        told = bool(options.longest_m) or options.edits.length is not None
        return guess_points(capture, box=options.box, models=models, size_known=told, tick=bar.tick("POINT_CLOUD"))
    cut, drawn = options.cut or "auto", options.edits.photos
    fill, tick = options.fill or "unseen", bar.tick("POINT_CLOUD")
    return to_points(capture, cut=cut, fill=fill, hold_out=hold_out, drawn=drawn, box=options.box, tick=tick)


def to_points(
    capture: Capture,
    *,
    voxel: float | None = None,
    cut: Cut = "auto",
    fill: Fill = "none",
    hold_out: int | None = None,
    drawn: frozenset[str] = frozenset(),
    box: PhotoBox | None = None,
    tick: Tick = no_tick,
) -> Points:
    """Make a clean, coloured point cloud of a capture, in its frame and units.

    voxel    distance between points in capture units; None: from the depth pixels' size, and a cloud is left as it is
    cut      what to keep: "object" the one in the middle, without what it stands on and what stands around it; "scene"
             everything; "auto" the object where photos were taken around one, and it is found
    fill     what of an object that is cut out is closed where no picture gave depth of it
    hold_out number of pictures that points and textures are not made from; None: a few of a capture that has many
    drawn    names of the pictures whose frames the points keep, for the lines that a person drew in them
    box      rectangle around the object in a named picture; None: it is the one in the middle

    Raises CaptureError: CAPTURE_TOO_FEW_POINTS where too few points remain, CAPTURE_NOTHING_LEFT where `cut` finds
    no object, BOX_PHOTO_UNUSED where the rectangle's picture has no depth, CAPTURE_NO_POSES where frames without poses
    cannot be placed, CAPTURE_BAD_POSE where poses contradict their frames. `tick` may raise `Cancelled`.
    """
    capture, tick = _with_poses(capture, tick)
    if capture.kind == "points":
        return _cloud_points(capture, voxel, cut, tick)
    wanted = what_to_keep(capture, cut, box)
    frames, held_out = hold_out_frames(capture.frames, hold_out)
    faults = FrameFaults()  # what is compared at the end of a job must not end it
    held_out = tuple(frame for frame in held_out if faults.read_depth(frame) and faults.read_picture(frame) is not None)
    fused, points = _fused_points(capture, frames, voxel, wanted, tick)
    points = replace(
        points,
        held_out_views=tuple(map(texture_view, held_out)),
        cameras=tuple(frame.picture for frame in capture.frames if frame.picture),
        drawn_in=tuple(frame for frame in capture.frames if frame.shown and frame.shown.name in drawn),
        warnings=(*points.warnings, *faults.warnings(len(fused.frames))),
    )
    points = _cut(points, replace(capture, frames=fused.frames), fused, wanted, fill, tick)
    if has_stereo_depth(frames):
        points = replace(points, warnings=points.warnings + flatness_warning(points.xyz))
    return points


def _with_poses(capture: Capture, tick: Tick) -> tuple[Capture, Tick]:
    """Compute the poses of frames that have none; return also the tick for the rest of the time to the points."""
    if capture.kind != "rgbd" or has_stereo_depth(capture.frames):  # stereo depth was made with its poses
        return capture, tick
    posed = with_poses(capture, lambda fraction: tick(_POSES * fraction))
    return (capture, tick) if posed is capture else (posed, part_of(tick, _POSES, 1))


def _cloud_points(capture: Capture, voxel: float | None, cut: Cut, tick: Tick) -> Points:
    """Clean a cloud, which is taken as it is where no object is asked for."""
    share = _share_to_cut(cut)
    points = cloud_points(capture, voxel=voxel, tick=lambda fraction: tick(share * fraction))
    if cut == "object":
        return isolate_object(replace(points, whole=None), tick=tick).points
    return replace(points, cut=_ALL_WANTED if cut == "scene" else CutReport("scene", say("cloud_taken")))


def _fused_points(
    capture: Capture, frames: tuple[Frame, ...], voxel: float | None, cut: Cut | Mark, tick: Tick
) -> tuple[FusedPoints, Points]:
    """Fuse frames and clean their points; a large scene box by box, unless an object is cut out of it in memory."""
    share = _share_to_cut(cut)
    in_parts = not has_stereo_depth(frames) and cut in ("auto", "scene")
    fused = (fuse_scene if in_parts else fuse)(frames, voxel=voxel, tick=lambda part: tick(0.8 * share * part))
    seen = replace(capture, frames=fused.frames)
    return fused, points_of_frames(seen, fused, lambda fraction: tick(share * (0.8 + 0.2 * fraction)))


def _share_to_cut(cut: Cut | Mark) -> float:
    """Share of the time to the points that passes before anything is cut out of them."""
    return 1.0 if cut == "scene" else 0.9


def _cut(points: Points, capture: Capture, fused: FusedPoints, cut: Cut | Mark, fill: Fill, tick: Tick) -> Points:
    """Keep the object's points alone, closed, with its unseen sides; all points where the capture shows a scene, and
    with a warning where no object is found.

    Raises CAPTURE_NOTHING_LEFT instead where an object is asked for, or marked.
    """
    if cut == "scene":
        return replace(points, cut=_ALL_WANTED)
    if cut == "auto" and (scene := sees_a_scene(capture.frames)):
        return replace(points, cut=CutReport("scene", scene))
    aim = sure_aim(capture.frames)
    try:
        isolated = _isolated(points, capture, fused, cut, aim, part_of(tick, 0, _CLOSING))
    except CaptureError as error:
        if cut != "auto":
            raise
        kept = CutReport("scene", say("no_thing_found_in_middle", why=error.message))
        left = say("surroundings_not_removed", why=error.message)
        return replace(points, cut=kept, warnings=(*points.warnings, left))
    if aim is not None and cut == "auto":
        require_aim(isolated.points.xyz, aim, fused.cameras)
    thing = replace(isolated.points, unseen=unseen_sides(isolated.points, capture.frames))
    closed = close_object(thing, isolated.support, fill, part_of(tick, _CLOSING, 1))
    few = has_stereo_depth(capture.frames) and len(capture.frames) <= FEW_PHOTOS
    return complete_back(closed, isolated.support) if few and fill != "none" else closed


def _isolated(
    points: Points, capture: Capture, fused: FusedPoints, cut: Cut | Mark, aim: Floats | None, tick: Tick
) -> IsolatedObject:
    """Cut out the marked object, or the one in the middle."""
    cameras, turntable = fused.cameras, capture.turntable
    if isinstance(cut, Mark):
        return isolate_marked(points, cut, cameras=cameras, turntable=turntable, tick=tick)
    masked, where = any(frame.load_mask for frame in capture.frames), fused.aim if aim is None else aim
    return isolate_object(points, aim=where, cameras=cameras, turntable=turntable, masked=masked, tick=tick)
