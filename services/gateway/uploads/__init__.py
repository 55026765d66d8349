"""Uploads: streamed to disk, checked file by file, freed of what tells who and where, packed as one archive."""
