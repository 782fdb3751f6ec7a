"""Floor 5, show: the command line."""

from .program import main

__all__ = ["main"]
