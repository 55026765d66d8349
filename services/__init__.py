"""capture2vr: reconstruct a phone's capture as a 3D asset for VR headsets."""

__version__ = "0.1.0"
