"""Floor 5, show: the command line.

A command imports what it computes with when it runs: `--help` and shell completion must not wait for JAX.
"""

from .program import main

__all__ = ["main"]
