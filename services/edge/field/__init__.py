"""Points in, an unsigned distance field out."""

from services.edge.field.denoise import denoise
from services.edge.field.folds import noise_of
from services.edge.field.local import local_field

__all__ = ["denoise", "local_field", "noise_of"]
