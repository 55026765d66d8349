"""capture2vr: a phone's capture in, an asset for a VR headset out."""

__version__ = "0.1.0"
