"""Read and write records and fits: one module for each format."""

from .fits import load, save
from .reading import read_record
from .writing import write_record

__all__ = ["load", "read_record", "save", "write_record"]
