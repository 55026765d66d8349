"""Draw the rooms of the product from its imports: `python docs/draw_rooms.py` writes docs/rooms.svg.

A room is a folder of a service, or files of its top folder that belong together. An arrow runs from a room to one that
it imports; arrows that follow from others are left out. Numbers are the way of a capture; `WAY` says what happens at
each. With --check nothing is written, and another picture than the committed one is an error; with --count it says how
many rooms and arrows the picture has, and how many the top level of services/ has.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURE = Path(__file__).with_name("rooms.svg")

SHARED = "(shared)"  # files that every room of a service may import; they import none, and arrows to them say nothing
# Files of a service's top folder that are rooms together; every other file there is a room of its own.
TOP_ROOMS = {
    "edge": {
        SHARED: ("arrays", "child_process", "errors", "parallel", "procrustes", "progress", "srgb"),
        "pipeline": ("pipeline", "training"),
        "preset": ("preset", "preset_choice"),
    },
    "gateway": {
        SHARED: ("errors", "database_faults", "languages"),
        "app": ("__main__", "app", "middleware", "opening", "running", "server"),
        "schemas": ("schemas", "settings", "metrics"),
    },
    "storage": {
        "store": ("store", "local", "memory", "s3", "bundle"),
        "settings": ("settings", "bucket"),
    },
}
WHOLE = ("cli", "client", "library", "web")  # services that are one room
BELOW_ALL = ("order", "process", "sentences")  # every service may import them, and arrows to them say nothing
LEFT_OUT = ("api", "presets")  # generated code; settings

WAY = (
    ("web", "capture", "The phone's page guides, checks and uploads photos, a video or a scan."),
    ("gateway", "uploads", "Streamed to disk, unpacked, every file checked."),
    ("gateway", "strip", "Places, names and serial numbers are removed from photos, videos and scans."),
    ("gateway", "jobs", "The capture is on the store, the job a row with a lease."),
    ("gateway", "dispatch", "A free worker is found; the run is followed, and found again when lost."),
    ("edge", "worker", "The archive arrives over gRPC, waits for a slot and for memory."),
    ("edge", "read_capture", "Its format is recognised and read: frames, photos or a cloud."),
    ("edge", "cameras", "Photos get their cameras: structure from motion."),
    ("edge", "photos", "Photos with cameras become depth maps: plane sweep."),
    ("edge", "fusion", "Depth is fused to points that several views agree on."),
    ("edge", "points", "Points are cleaned, and the object is cut out."),
    ("edge", "field", "An unsigned distance field is fitted: local at once, then trained."),
    ("edge", "mesh", "The open surface is extracted, cleaned and simplified."),
    ("edge", "texture", "Levels of detail get textures from the photos."),
    ("edge", "export", "Files for headsets, browsers, phones: GLB, KTX2, USDZ, PLY."),
    ("edge", "asset", "Files and manifest are a bundle; the preview first, the refined one later."),
    ("storage", "catalogue", "Published: files, then manifest, then the signed catalogue."),
    ("web", "viewer", "The headset pulls the asset by its key."),
)

Room = tuple[str, str]
Arrows = Mapping[Room, set[Room]]


def rooms_and_arrows() -> Arrows:
    """Every room with the rooms that it imports."""
    arrows: dict[Room, set[Room]] = defaultdict(set)
    for path in sorted((ROOT / "services").rglob("*.py")):
        room = room_of(path.relative_to(ROOT / "services").with_suffix("").parts)
        if room is None:
            continue
        arrows[room] |= set()
        for module in _imports(path):
            other = room_of(module)
            if other is not None and other != room and other[1] != SHARED:
                arrows[room].add(other)
    for page in sorted((ROOT / "services" / "web").iterdir()):
        if page.is_dir() and page.name not in ("vendor", "__pycache__"):
            arrows["web", page.name] = {("web", name) for name in _pages_that(page)} - {("web", page.name)}
    return arrows


def room_of(parts: Iterable[str]) -> Room | None:
    """The room of a module, from its parts below services/; None for what is no room."""
    service, *rest = parts
    if not rest or service == "web" or service in BELOW_ALL:
        return None
    if service in WHOLE:
        return service, service
    if len(rest) > 1:
        return None if rest[0] in LEFT_OUT else (service, rest[0])
    name = rest[0]
    if name == "__init__" or name in LEFT_OUT:
        return None
    if (ROOT / "services" / service / name).is_dir():
        return service, name
    return service, next((room for room, files in TOP_ROOMS.get(service, {}).items() if name in files), name)


def _imports(path: Path) -> set[tuple[str, ...]]:
    """Modules below services/ that a file imports, as parts."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("capture2vr."):
            base = node.module.split(".")[1:]
            for alias in node.names:
                inner = ROOT.joinpath("services", *base, alias.name)
                found.add(tuple([*base, alias.name] if inner.with_suffix(".py").is_file() else base))
    return found


def _pages_that(page: Path) -> set[str]:
    """Folders of services/web whose modules those of a folder import."""
    text = "\n".join(module.read_text() for module in page.glob("*.js"))
    paths = re.findall(r"(?:from|import\(|URL\()\s*'(\.\./[^']+)'", text)
    return {path.split("/")[1] for path in paths} - {"vendor"}


def reduced(arrows: Arrows) -> dict[Room, set[Room]]:
    """The arrows without those that follow from two others."""
    below: dict[Room, set[Room]] = {}

    def reach(room: Room) -> set[Room]:
        if room not in below:
            below[room] = set()  # a circle would end here
            below[room] = set().union(*({other} | reach(other) for other in arrows.get(room, ())))
        return below[room]

    return {
        room: {other for other in others if not any(other in reach(third) for third in others - {other})}
        for room, others in arrows.items()
    }


def floors(arrows: Arrows) -> dict[Room, int]:
    """How high each room stands: above all that it imports."""
    found: dict[Room, int] = {}

    def floor(room: Room) -> int:
        if room not in found:
            found[room] = 0
            found[room] = 1 + max((floor(other) for other in arrows.get(room, ())), default=-1)
        return found[room]

    for room in arrows:
        floor(room)
    return found


# ---- the picture: services side by side, rooms by floor ----

BOX_W, BOX_H, GAP_X, GAP_Y = 118, 34, 14, 40
MARGIN, TITLE_H = 24, 34
COLUMNS = ("web", "gateway", "client", "library", "edge", "storage")  # and the command line above them all
WIRES = ((("web", "shared"), ("gateway", "routes"), "HTTP"), (("gateway", "workers"), ("edge", "worker"), "gRPC"))
STYLE = """
text { font: 13px system-ui, sans-serif; fill: #1c2530 }
.service { fill: #f4f6f8; stroke: #d5dbe2 }
.title { font-weight: 600; font-size: 14px }
.room { fill: #fff; stroke: #5b6b7d }
.arrow { fill: none; stroke: #93a1b1; marker-end: url(#head) }
.wire { fill: none; stroke: #b4531f; stroke-dasharray: 5 4; marker-end: url(#head) }
.wired { fill: #b4531f; font-size: 12px }
.step { fill: #1f6fb4 }
.number { fill: #fff; font-size: 11px; font-weight: 600; text-anchor: middle }
.way { font-size: 13px }
"""


def picture() -> str:
    """The SVG."""
    arrows = reduced(rooms_and_arrows())
    floor = floors(rooms_and_arrows())
    places = _places(arrows, floor)
    width = max(x for x, _ in places.values()) + BOX_W + 2 * MARGIN
    bottom = max(y for _, y in places.values()) + BOX_H + 2 * MARGIN
    height = bottom + 22 * ((len(WAY) + 1) // 2) + 3 * MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">',
        f"<style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 z" fill="#93a1b1"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        *_services(places),
        *(_arrow(places[a], places[b]) for a in sorted(arrows) for b in sorted(arrows[a])),
        *(_wire(places[a], places[b], name) for a, b, name in WIRES),
        *(_room(room, places[room]) for room in sorted(places)),
        *_way(places, bottom, width),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _places(arrows: Arrows, floor: Mapping[Room, int]) -> dict[Room, tuple[int, int]]:
    """Left upper corner of each box: services side by side, higher floors above; within one, near what it imports."""
    top = max(floor.values())
    places: dict[Room, tuple[int, int]] = {}
    left = MARGIN
    for service in COLUMNS:
        rooms = [room for room in arrows if room[0] == service and room[1] != SHARED]
        rows = [[room for room in rooms if floor[room] == level] for level in range(top + 1)]
        across = max(len(row) for row in rows)
        inner = across * (BOX_W + GAP_X) - GAP_X
        for level, row in enumerate(rows):
            row.sort(key=lambda room: (_middle(arrows[room], places), room))
            spread = inner / len(row) if row else 0
            for number, room in enumerate(row):
                x = left + GAP_X + round(spread * (number + 0.5) - BOX_W / 2)
                places[room] = (x, MARGIN + TITLE_H + BOX_H + GAP_Y + (top - level - 1) * (BOX_H + GAP_Y))
        left += inner + 2 * GAP_X + MARGIN
    places["cli", "cli"] = (round(_middle(arrows["cli", "cli"], places)), MARGIN)
    return places


def _middle(rooms: set[Room], places: Mapping[Room, tuple[int, int]]) -> float:
    known = [places[room][0] for room in rooms if room in places]
    return sum(known) / len(known) if known else 1e6


def _services(places: Mapping[Room, tuple[int, int]]) -> list[str]:
    parts = []
    for service in COLUMNS:
        inside = [place for room, place in places.items() if room[0] == service]
        x0, x1 = min(x for x, _ in inside) - GAP_X, max(x for x, _ in inside) + BOX_W + GAP_X
        y0, y1 = min(y for _, y in inside) - TITLE_H, max(y for _, y in inside) + BOX_H + GAP_X
        parts.append(f'<rect class="service" x="{x0}" y="{y0}" width="{x1 - x0}" height="{y1 - y0}" rx="8"/>')
        parts.append(f'<text class="title" x="{x0 + 12}" y="{y0 + 21}">services/{service}</text>')
    return parts


def _room(room: Room, place: tuple[int, int]) -> str:
    x, y = place
    name = "services/cli" if room[0] == "cli" else room[1].replace("__main__", "start").replace("_", " ")
    return (
        f'<rect class="room" x="{x}" y="{y}" width="{BOX_W}" height="{BOX_H}" rx="5"/>'
        f'<text x="{x + BOX_W // 2}" y="{y + 21}" text-anchor="middle"{_squeezed(name)}>{escape(name)}</text>'
    )


def _squeezed(name: str) -> str:
    """For a name that is too long for its box at its own width."""
    return f' textLength="{BOX_W - 12}" lengthAdjust="spacingAndGlyphs"' if 7.5 * len(name) > BOX_W - 12 else ""


def _arrow(start: tuple[int, int], end: tuple[int, int]) -> str:
    (x0, y0), (x1, y1) = (start[0] + BOX_W // 2, start[1] + BOX_H), (end[0] + BOX_W // 2, end[1])
    if y1 <= y0:  # to another service, on the same floor or above
        right = end[0] > start[0]
        x0, y0 = start[0] + (BOX_W if right else 0), start[1] + BOX_H // 2
        x1, y1 = end[0] + (0 if right else BOX_W), end[1] + BOX_H // 2
        bend = (x0 + x1) // 2
        return f'<path class="arrow" d="M{x0},{y0} C{bend},{y0} {bend},{y1} {x1},{y1}"/>'
    bend = (y1 - y0) // 2
    return f'<path class="arrow" d="M{x0},{y0} C{x0},{y0 + bend} {x1},{y1 - bend} {x1},{y1}"/>'


def _wire(start: tuple[int, int], end: tuple[int, int], name: str) -> str:
    (x0, y0), (x1, y1) = (start[0] + BOX_W, start[1] + BOX_H // 2), (end[0], end[1] + BOX_H // 2)
    bend = (x0 + x1) // 2
    return (
        f'<path class="wire" d="M{x0},{y0} C{bend},{y0} {bend},{y1} {x1},{y1}"/>'
        f'<text class="wired" x="{bend + 4}" y="{(y0 + y1) // 2 - 6}">{name}</text>'
    )


def _way(places: Mapping[Room, tuple[int, int]], top: int, width: int) -> list[str]:
    """A number on each room that a capture comes through, and what happens there, below."""
    parts = [f'<text class="title" x="{MARGIN}" y="{top}">The way of a capture</text>']
    half = (len(WAY) + 1) // 2
    for number, (service, name, what) in enumerate(WAY, start=1):
        x, y = places[service, name]
        column, row = divmod(number - 1, half)
        left, line = MARGIN + column * (width // 2), top + 26 + 22 * row
        parts += [_number(x, y, number), _number(left + 9, line - 4, number)]
        parts.append(f'<text class="way" x="{left + 26}" y="{line}">{escape(what)}</text>')
    return parts


def _number(x: int, y: int, number: int) -> str:
    return f'<circle class="step" cx="{x}" cy="{y}" r="9"/><text class="number" x="{x}" y="{y + 4}">{number}</text>'


def counts() -> str:
    """How many rooms and arrows the picture has, and how many the top level has: folders and files of services/."""
    drawn = {room: others for room, others in reduced(rooms_and_arrows()).items() if room[1] != SHARED}
    return "\n".join(
        f"{name}: {len(arrows)} rooms, {sum(map(len, arrows.values()))} arrows"
        for name, arrows in (("picture", drawn), ("top level", top_level()))
    )


def top_level() -> dict[str, set[str]]:
    """Every folder and file directly below services/ that holds Python, with those that it imports."""
    arrows: dict[str, set[str]] = defaultdict(set)
    for path in (ROOT / "services").rglob("*.py"):
        name, *_ = path.relative_to(ROOT / "services").with_suffix("").parts
        if name != "__init__":
            arrows[name] |= {module[0] for module in _imports(path) if module} - {name}
    return arrows


def main() -> int:
    """Write the picture; with --check, exit 1 where the committed one is another; with --count, count."""
    if "--count" in sys.argv[1:]:
        sys.stdout.write(counts() + "\n")
        return 0
    made = picture()
    if "--check" in sys.argv[1:]:
        if PICTURE.read_text() != made:
            sys.stderr.write(f"{PICTURE} is not what the imports say: run python docs/draw_rooms.py\n")
            return 1
        return 0
    PICTURE.write_text(made)
    return 0


if __name__ == "__main__":
    sys.exit(main())
