"""Names by which XMP tells the part that a panorama shows: what the gateway keeps of it, and what the worker reads.

Google's "Photo Sphere XMP Metadata", in its namespace GPano.
"""

AREA = (
    b"FullPanoWidthPixels",
    b"FullPanoHeightPixels",
    b"CroppedAreaImageWidthPixels",
    b"CroppedAreaImageHeightPixels",
    b"CroppedAreaLeftPixels",
    b"CroppedAreaTopPixels",
)
"""Width and height of the whole, and of the part; where the part's left and upper edges lie in it. All in pixels."""
