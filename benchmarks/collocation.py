"""From the tests: the reference formulation, `scipy.integrate.solve_bvp`, scenes as it takes them, the hard scenes.

And that formulation within a limit of time, as the benchmarks ask it.
"""

import signal
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import hard
import reference
from conversion import plain

__all__ = ["Tip", "collocated", "hard", "plain", "reference"]


class Tip(NamedTuple):
    """What a method makes of a scene: a tip [m] if it found one, how, and the seconds that it took."""

    found: bool
    x: float
    y: float
    how: str
    seconds: float


def collocated(plain: dict[str, Any], cold: bool, limit: int = 15) -> Tip:
    """What `solve_bvp` makes of a scene within `limit` seconds of CPU time, so that other work takes nothing away."""

    def give_up(*_: Any) -> None:
        raise TimeoutError

    signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, limit)
    begin = time.process_time()
    try:
        found = reference.solve(plain, tol=1e-8, cold=cold)
        outcome = (found.converged, found.x, found.y, found.message)
    except TimeoutError:
        outcome = (False, np.nan, np.nan, f"given up after {limit} s")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return Tip(*outcome, time.process_time() - begin)
