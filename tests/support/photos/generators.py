"""A generator on loopback that answers as it is told, by trellis-server's two routes, and a thing for it to make."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from email.parser import BytesParser
from email.policy import HTTP
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.renderer import RenderMesh, place_cameras, render_view
from capture2vr.edge.srgb import to_srgb

Tell = Callable[[BaseHTTPRequestHandler], None]
"""Writes an answer to POST /generate."""

BOXES = (
    ((0.0, 0.0, 0.0), (1.0, 0.25, 0.25), (200, 40, 40)),
    ((0.35, 0.3, 0.05), (0.2, 0.5, 0.2), (40, 200, 40)),
    ((-0.3, 0.1, 0.3), (0.2, 0.2, 0.5), (40, 40, 200)),
)
"""Middle, sides and colour of the boxes of a thing that looks another way from each side."""


@dataclass
class StubGenerator:
    """What it was asked, and what it answers. asked: the routes; fields: the names and contents of the last form."""

    url: str = ""
    tell: Tell | None = None
    health: int = 200
    asked: list[str] = field(default_factory=list)
    fields: dict[str, bytes] = field(default_factory=dict)


@contextmanager
def generator(tell: Tell, health: int = 200) -> Iterator[StubGenerator]:
    """Run a stub in threads of its own."""
    stub = StubGenerator(tell=tell, health=health)

    class StubHandler(BaseHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Say nothing."""

        def do_GET(self) -> None:
            stub.asked.append(self.path)
            write(self, b"ok", status=stub.health)

        def do_POST(self) -> None:
            stub.asked.append(self.path)
            body = self.rfile.read(int(self.headers["Content-Length"]))
            head = f"Content-Type: {self.headers['Content-Type']}\r\n\r\n".encode()
            form: Any = BytesParser(policy=HTTP).parsebytes(head + body)
            stub.fields = {
                part.get_param("name", header="content-disposition"): part.get_content() for part in form.iter_parts()
            }
            with suppress(OSError):  # the client has hung up
                tell(self)

    server = ThreadingHTTPServer(("127.0.0.1", 0), StubHandler)
    server.daemon_threads = True
    stub.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield stub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def write(
    to: BaseHTTPRequestHandler, body: bytes, *, status: int = 200, kind: str = "text/plain", size: int = -1
) -> None:
    """Write an answer. size: that it announces, if another than the body's"""
    to.send_response(status)
    to.send_header("Content-Type", kind)
    to.send_header("Content-Length", str(len(body) if size < 0 else size))
    to.end_headers()
    to.wfile.write(body)


def glb(content: bytes) -> Tell:
    """Tell a GLB, as trellis-server does."""
    return lambda to: write(to, content, kind="model/gltf-binary")


def boxes(turn: float = 0.0, size: float = 1.0, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    """The thing of `BOXES`, turned by degrees about the vertical, scaled, then moved."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([sides[:, [0, 1, 2]], sides[:, [0, 2, 3]]])
    vertices: Floats = np.concatenate([corners * lengths + middle for middle, lengths, _ in BOXES])
    rgb: Bytes = np.repeat(np.array([colour for *_, colour in BOXES], np.uint8), 8, axis=0)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    turned = vertices @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    all_faces = np.concatenate([faces + 8 * number for number in range(len(BOXES))])
    return Mesh(size * turned + np.array(offset), all_faces, rgb)


def boxes_glb(turn: float = 0.0, size: float = 1.0, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> bytes:
    return to_glb(boxes(turn, size, offset))


def points_on(mesh: Mesh, count: int = 40_000) -> tuple[Floats, Bytes]:
    """Points (N,3) all over a mesh, and their colours."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), count)
    assert mesh.rgb is not None
    return np.einsum("nc,ncd->nd", weights, corners[chosen]), mesh.rgb[mesh.faces[chosen, 0]]


def photo_of(mesh: Mesh, side: int, height: float = 0.0) -> tuple[Bytes, Bools]:
    """A picture (side,side,3) of a mesh before grey, and its mask: from +z, `height` degrees over the horizon."""
    subject = RenderMesh.of(mesh, side, sky_rays=1)
    (camera,) = place_cameras(subject, (0.0,), height)
    view = render_view(subject, camera, side)
    rgb = to_srgb(view.light + (1 - view.cover) * np.float32(0.6))
    return rgb, np.asarray(view.cover[..., 0] > 0.5)
