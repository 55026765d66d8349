"""Draw QR codes."""

from __future__ import annotations

import io

_SCALE, _BORDER = 8, 4  # pixels per module; the quiet zone that ISO/IEC 18004 asks for


def qr_svg(text: str) -> bytes:
    """Return a text as a QR code: an SVG document."""
    import segno

    buffer = io.BytesIO()
    segno.make(text, micro=False).save(buffer, kind="svg", scale=_SCALE, border=_BORDER, light="#fff")
    return buffer.getvalue()
