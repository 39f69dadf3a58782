"""The command `vibrid`."""

from .app import main

__all__ = ["main"]
