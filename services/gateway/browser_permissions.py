"""The header Permissions-Policy: what a page may ask the browser for."""

from __future__ import annotations

_OTHERS = (
    "accelerometer=(self), gyroscope=(self), magnetometer=(self), xr-spatial-tracking=(self), "
    "microphone=(), geolocation=(), payment=(), usb=(), serial=(), bluetooth=(), display-capture=()"
)

ANY_PAGE = f"camera=(), {_OTHERS}"
"""What all pages may use, for themselves alone: tilt and turn of a phone, a headset."""
CAMERA_PAGE = f"camera=(self), {_OTHERS}"
"""The same, and the camera."""
