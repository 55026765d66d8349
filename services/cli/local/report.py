"""HTML report of a run: one self-contained page with the pictures and quality figures of preview and refined mesh."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from capture2vr.cli.grade_line import grade_line, origin_line, other_warnings
from capture2vr.edge.origin import COLOURS, PICTURE

_ROWS = {
    "held_out": ("held-out points", "not used for either surface; if 0, the input points are used instead", "{:,}"),
    "held_out_mean": ("their mean distance", "to the surface; the longest side is 1", "{:.5f}"),
    "held_out_median": ("median", "", "{:.5f}"),
    "held_out_p95": ("95th percentile", "", "{:.5f}"),
    "coverage": ("coverage", "fraction of them within one point spacing of the surface", "{:.1%}"),
    "stray_area": ("stray area", "fraction of the surface without points near it", "{:.2%}"),
    "consistency": (
        "inconsistency of the field",
        "1 − |cos| between its gradients at a point and at the point's projection",
        "{:.4f}",
    ),
    "components": ("pieces", "", "{:,}"),
    "boundary_loops": ("border loops", "", "{:,}"),
    "boundary_length": ("border length", "the longest side is 1", "{:.2f}"),
    "border_over_root": ("border over the root of the area", "0 is closed, a dress has 6", "{:.2f}"),
    "fringe": ("raggedness of the borders", "how many times as long they are as when they are smoothed", "{:.2f}"),
    "largest_hole": ("inside seen from outside", "from where it is seen most, of 20 directions", "{:.1%}"),
    "non_manifold_edges": ("non-manifold edges", "", "{:,}"),
    "triangles": ("triangles", "", "{:,}"),
    "resolution": ("cells along the longest side", "", "{:,}"),
    "steps": ("training steps", "", "{:,}"),
    "device": ("device", "", "{}"),
    "seconds": ("seconds until this mesh", "", "{:.1f}"),
}
"""Key of the certificate -> name, explanation, number format."""

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #222 }
figure { display: inline-block; width: 49%; margin: 0; vertical-align: top } img { width: 100% }
figure.small { width: 24rem; max-width: 49% }
@media (max-width: 40rem) { figure { width: 100% } }
table { border-collapse: collapse; margin: 1rem 0 } th, td { text-align: left; padding: .2rem 1rem .2rem 0 }
td.figure { text-align: right; font-variant-numeric: tabular-nums } small { color: #666 }
p.warning { border-left: .25rem solid #c80; padding-left: .75rem }
"""


_PHOTO_ROWS = {
    "photos": ("held-out photos", "not used for points or textures", "{:,}"),
    "cover": ("of the object in them covered", "", "{:.1%}"),
    "lace": ("holes", "share of the object's filled silhouette without mesh", "{:.2%}"),
    "worst_lace": ("holes in the worst photo", "", "{:.2%}"),
    "inside_out": ("inside seen through holes", "share of the mesh's pixels", "{:.2%}"),
    "leak": ("surface beside the object", "share of the mesh's pixels where the photos show background", "{:.2%}"),
    "depth": ("of their depth within 1 %", "", "{:.1%}"),
    "psnr": ("likeness, PSNR", "dB, after one gain per channel", "{:.2f}"),
    "ssim": ("likeness, SSIM", "1 is the same", "{:.3f}"),
    "sharp": ("sharpness", "of the texture over the photos': variance of the Laplacian", "{:.2f}"),
}
"""Key of the certificate's `photos` -> name, explanation, number format."""


def report_page(
    report: Mapping[str, Any], pictures: Mapping[str, bytes], compared: Mapping[str, bytes] | None = None
) -> str:
    """Return the HTML of a report.

    pictures  PNG by state, the preview first
    compared  JPEG by name: what a cut kept and what it was made from; held-out photos beside renderings, with holes
              marked; and as PNG what was measured and what was not
    """
    title = escape(report["label"] or report["key"])
    certificates = {state: each for state, each in report["certificates"].items() if each}
    refused = ", not published" if _is_refused(report) else ""
    return "\n".join(
        [
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>',
            f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style>',
            f"<h1>{title}</h1>",
            *_bold(origin_line(report["origin"])),
            *_grade(report["quality"].get("grade")),
            *_summary(report),
            *(_figure(state, png) for state, png in pictures.items()),
            "<table><tr><th></th>",
            *(f"<th>{escape(state)}{refused if state == 'refined' else ''}</th>" for state in certificates),
            "</tr>",
            *_certificate_rows(certificates),
            "</table>",
            *_cut(report["capture"].get("cut"), compared or {}),
            *_origins(report["origins"], compared or {}),
            *_pieces(certificates),
            *_compared_photos(compared or {}),
            *_reference_table(report["reference"]),
            *_stages(report["seconds"]),
            *_photos(report["capture"]["photos"]),
            *_unseen(report["capture"]["unseen"]),
            *(
                f'<p class="warning">{escape(warning)}</p>'
                for warning in other_warnings(report["quality"].get("grade"), report["warnings"])
            ),
            "</html>\n",
        ]
    )


def _cut(cut: Mapping[str, Any] | None, compared: Mapping[str, bytes]) -> Iterator[str]:
    """Yield what was kept of the capture and why; after a cut also pictures of both, and how to get the other."""
    if not cut:
        return
    yield f"<h2>What was kept</h2><p>{_KEPT[cut['kept']]}: {escape(cut['because'])}.</p>"
    if cut["doubt"]:
        yield f'<p class="warning">{escape(cut["doubt"])}</p>'
    for name, caption in _CUT_PICTURES.items():
        if name in compared:
            yield f'<figure class="small"><img src="{_jpeg(compared[name])}" alt="{name}">'
            yield f"<figcaption>{caption}</figcaption></figure>"


_KEPT = {"object": "The object in the middle", "scene": "Everything that was seen"}
_CUT_PICTURES = {
    "cut-object.jpg": "kept: the object, <code>--cut object</code>",
    "cut-scene.jpg": "it was cut from this: <code>--cut scene</code>",
}


def _origins(points: Mapping[str, int], compared: Mapping[str, bytes]) -> Iterator[str]:
    """Yield what was measured, proposed and filled: the points' numbers, and a picture; nothing without one."""
    if PICTURE not in compared:
        return
    picture = f"data:image/png;base64,{b64encode(compared[PICTURE]).decode()}"
    yield f'<h2>What was measured</h2><figure><img src="{picture}" alt="{PICTURE}"><figcaption>'
    for (key, (name, _)), colour in zip(_ORIGINS.items(), COLOURS, strict=True):
        yield f'<b style="color: rgb{colour}">■</b> {name} ({points[key]:,} points) '
    yield "</figcaption></figure>"


_ORIGINS = {
    "measured": ("measured", "share of the surface that pictures or a scanner saw"),
    "proposed": ("proposed", "share of the surface that is a guess"),
    "filled": ("filled in", "share of the surface that closes what is around it, and no picture shows surely"),
}
"""Name of an origin -> name for people, explanation; in the order of `COLOURS`."""


def _jpeg(content: bytes) -> str:
    return f"data:image/jpeg;base64,{b64encode(content).decode()}"


def _pieces(certificates: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Yield the pieces of the last surface, kept and dropped, with the reason for each."""
    pieces = list(certificates.values())[-1].get("pieces") if certificates else None
    if not pieces:
        return
    yield "<h2>Pieces</h2><table><tr><th>share of the area</th><th>pieces</th><th></th><th></th></tr>"
    for each in pieces:
        fate = "kept" if each["kept"] else "dropped"
        yield f'<tr><td class="figure">{each["share"]:.2%}</td><td class="figure">{each["count"]:,}</td>'
        yield f"<td>{fate}</td><td>{escape(each['reason'])}</td></tr>"
    yield "</table>"


def _compared_photos(compared: Mapping[str, bytes]) -> Iterator[str]:
    """Yield held-out photos beside renderings from the same camera."""
    apart = (*_CUT_PICTURES, PICTURE)
    photos = {name: content for name, content in compared.items() if name not in apart}
    if not photos:
        return
    yield "<h2>Compared with photos that were not used</h2>"
    yield "<p><small>left the photo, right the mesh from its camera; magenta: holes, yellow: the inside of the object, "
    yield "blue: surface where the photo shows background</small></p>"
    for name, content in photos.items():
        yield f'<img src="{_jpeg(content)}" alt="{escape(name)}">'


def _grade(grade: Mapping[str, str] | None) -> Iterator[str]:
    """Yield how good the asset is, where photos tell."""
    yield from _bold(grade_line(grade) if grade else "")


def _bold(line: str) -> Iterator[str]:
    if line:
        yield f"<p><b>{escape(line)}</b></p>"


def _summary(report: Mapping[str, Any]) -> Iterator[str]:
    size = " × ".join(f"{side:.3g}" for side in report["size_m"])
    chosen = f" ({escape(report['preset_because'])})" if report["preset_because"] else ""
    yield f"<p>{report['points']:,} points, {size} m (scale {escape(report['scale_confidence'])}), "
    yield f"preset {escape(report['preset'])}{chosen}</p>"
    if up := report["capture"].get("up"):
        yield f"<p>Up is told by {_UP_SOURCES[up['source']]} (confidence {up['confidence']:.2f}).</p>"
    if report["verdict"]:
        so = ", so the preview is the result" if _is_refused(report) else ""
        yield f"<p>The refined surface is <b>{_VERDICTS[report['verdict']]}{so}</b>: {escape(report['because'])}</p>"


def _is_refused(report: Mapping[str, Any]) -> bool:
    """Return whether the refined surface was rejected as worse than the preview; never of a literature method."""
    refused: bool = report["verdict"] == "worse" and report["state"] != "refined"
    return refused


_UP_SOURCES = {
    "person": "the edits",
    "app": "the capture itself",
    "gravity": "gravity, as the photos' metadata have it",
    "turntable": "the turntable's axis",
    "lines": "vertical lines in the pictures",
    "walk": "the plane in which the cameras went around",
    "plane": "the floor, or what the object stands on",
    "cameras": "how the cameras were held",
}

_VERDICTS = {
    "better": "better than the preview",
    "even": "as good as the preview",
    "worse": "worse than the preview",
}


def _reference_table(reference: Mapping[str, float] | None) -> Iterator[str]:
    """Yield the table of distances between the result and the reference mesh, if one was given."""
    if not reference:
        return
    yield "<h2>Comparison with the reference</h2>"
    yield "<p><small>aligned by the best similarity transform; distances / the reference's size</small></p>"
    yield "<table>"
    for key, name in _REFERENCE_ROWS.items():
        yield f'<tr><td>{name}</td><td class="figure">{reference[key]:.3%}</td></tr>'
    yield "</table>"


_REFERENCE_ROWS = {
    "median": "median distance of the surface to the reference",
    "p90": "90th percentile",
    "complete": "fraction of the reference within 1 % of the surface",
    "beside": "fraction of the surface that is not part of the reference",
}


def _stages(seconds: Mapping[str, float]) -> Iterator[str]:
    yield "<h2>Seconds</h2><table>"
    for stage, spent in seconds.items():
        yield f'<tr><td>{escape(stage.lower().replace("_", " "))}</td><td class="figure">{spent:.1f}</td></tr>'
    yield "</table>"


def _photos(verdicts: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the table with the result for each photo, for captures of photos."""
    if not verdicts:
        return
    yield "<h2>Photos</h2><table>"
    for each in verdicts:
        name, verdict, advice = (escape(each[key]) for key in ("name", "verdict", "advice"))
        yield f"<tr><td>{name}</td><td>{verdict.replace('_', ' ')}</td><td>{advice}</td></tr>"
    yield "</table>"


def _unseen(sides: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield advice from where to take more photos, for sides that were hardly seen."""
    if not sides:
        return
    yield "<h2>What to photograph again</h2><ul>"
    yield from (f"<li>{escape(each['advice'])}</li>" for each in sides)
    yield "</ul>"


def _figure(state: str, png: bytes) -> str:
    source = f"data:image/png;base64,{b64encode(png).decode()}"
    return f'<figure><img src="{source}" alt="{escape(state)}"><figcaption>{escape(state)}</figcaption></figure>'


def _certificate_rows(certificates: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    for key, (name, meaning) in _ORIGINS.items():
        yield _row(name, meaning, [f"{each['origins'][key]:.2%}" for each in certificates.values()])
    for key, (name, meaning, form) in _ROWS.items():
        yield _row(name, meaning, [form.format(each[key]) for each in certificates.values()])
    photos = [each.get("photos") or {} for each in certificates.values()]
    for key, (name, meaning, form) in _PHOTO_ROWS.items():
        if any(each.get(key) is not None for each in photos):
            yield _row(name, meaning, ["" if each.get(key) is None else form.format(each[key]) for each in photos])


def _row(name: str, meaning: str, figures: Sequence[str]) -> str:
    cells = "".join(f'<td class="figure">{figure}</td>' for figure in figures)
    return f"<tr><td>{name} <small>{meaning}</small></td>{cells}</tr>"
