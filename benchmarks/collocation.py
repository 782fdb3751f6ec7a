"""From the tests: the reference formulation, `scipy.integrate.solve_bvp`, scenes as it takes them, the hard scenes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import hard
import reference
from conversion import plain

__all__ = ["hard", "plain", "reference"]
