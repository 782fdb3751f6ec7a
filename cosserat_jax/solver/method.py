"""How to solve: single and multiple shooting along the arm, adaptive steps in time."""

import functools as ft

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float, PyTree

from ..numerics.runge_kutta import Tableau
from ..physics.tcam import fastest_rate
from ..scene import TCAM
from ..scene.quantity import concrete

_MOST_GRIDS = 5  # of single shooting
_COARSE_ROOM = 6  # steps that any program has room for on the coarse grid, so that methods share it
_STIFF_RATE = 1000.0  # 1 / s; see `TimeStepping.suited_to`


def error_norm(errors: PyTree) -> Float[Array, ""]:
    """Root mean square, infinite instead of NaN: a state that is NaN from the start is given up after a few ever
    shorter steps, where diffrax would take all that it may, and a whole batch would wait for it."""
    size = optimistix.rms_norm(errors)
    return jnp.where(jnp.isnan(size), jnp.inf, size)


class SingleShooting(eqx.Module):
    """Integration from tip to base in equal steps, closed by Newton, the loads raised in steps where that is needed.

    - `error`: the error of the tip's pose asked for, in radians and lengths of the arm. It is estimated from the
      difference between two numbers of steps as if errors fell at the third order: they fall at the eighth, or at the
      third to fourth where a current changes sides along the arm and its force is not smooth. A rod above it has the
      outcome `inaccurate`.
    - `steps`: numbers of steps in each segment, tried in turn until the error is small enough; two to five numbers, at
      least six each.
    - `coarse_steps`: of the grid on which the branch is followed in the load, before it is polished on those of
      `steps`; at least three.
    - `newton_tol`: Newton stops on the coarse grid after a step below this, in radians and lengths; what is left is
      polished on the finer ones.
    - `max_iterations`: Newton steps, over all load steps, before the outcome is `iterations_exhausted`.
    - `min_load_step`: fraction of the load reached below which a load step is given up as standing before a limit.
    - `solver`: any explicit Runge-Kutta method of diffrax, for its coefficients.

    All but the solver and the largest number of steps are data to the compiled program. The defaults are chosen from
    error against run time, see `benchmarks/error_vs_runtime.py`: Dopri8 (Prince & Dormand, "High order embedded
    Runge-Kutta formulae", 1981) leaves 4e-9 lengths in ten steps of the paper's arm.
    """

    error: float = eqx.field(static=True, default=1e-8)
    steps: tuple[int, ...] = eqx.field(static=True, default=(10, 13, 20, 40, 80))
    coarse_steps: int = eqx.field(static=True, default=3)
    newton_tol: float = eqx.field(static=True, default=1e-4)
    max_iterations: int = eqx.field(static=True, default=60)
    min_load_step: float = eqx.field(static=True, default=1e-4)
    solver: diffrax.AbstractERK = diffrax.Dopri8()

    def __check_init__(self) -> None:
        if not 2 <= len(self.steps) <= _MOST_GRIDS or self.steps[0] < 6 or list(self.steps) != sorted(set(self.steps)):
            raise ValueError(f"steps must be two to {_MOST_GRIDS} growing numbers from 6 on, but are {self.steps}")
        if self.coarse_steps < 3:
            raise ValueError(f"coarse_steps must be at least 3, but is {self.coarse_steps}")

    def __str__(self) -> str:
        return f"single shooting in {self.steps[0]} steps and more"

    @property
    def settings(self) -> Float[np.ndarray, " settings"]:
        """What is data to the compiled program."""
        numbers = (self.coarse_steps, self.error, self.newton_tol, self.max_iterations, self.min_load_step)
        grids = self.steps + self.steps[-1:] * (_MOST_GRIDS - len(self.steps))
        return np.array([*numbers, len(self.steps), *grids], float)

    @property
    def rooms(self) -> tuple[int, int]:
        """The most steps that the compiled program has room for, and on the coarse grid."""
        return max(self.coarse_steps, *self.steps), max(_COARSE_ROOM, self.coarse_steps)


class MultipleShooting(eqx.Module):
    """The arm cut into intervals, short where its state changes fast, with the state at every cut unknown: slower than
    single shooting, and not impressed by an ill-conditioned arm under high axial tension.

    - `intervals`: how many. `steps`: equal steps in each; the error is estimated against half as many.
    - `error`, `newton_tol`, `max_iterations`, `min_load_step`, `solver`: as of `SingleShooting`.
    """

    intervals: int = eqx.field(static=True, default=64)
    steps: int = eqx.field(static=True, default=8)
    error: float = eqx.field(static=True, default=1e-8)
    newton_tol: float = eqx.field(static=True, default=1e-6)
    max_iterations: int = eqx.field(static=True, default=150)
    min_load_step: float = eqx.field(static=True, default=1e-4)
    solver: diffrax.AbstractERK = diffrax.Dopri8()

    def __str__(self) -> str:
        return f"multiple shooting in {self.intervals} intervals"


class Automatic(eqx.Module):
    """What `solve` and `sweep` do by default: `methods` in turn, each for the rods that the one before did not solve.

    First single shooting on two grids, so that in a batch no rod waits for the finer grids of another; for what that
    loses, single shooting on finer grids; for what that loses, multiple shooting, and where that gives up short of a
    limit point and of a fold, multiple shooting in four times as many intervals. Which rods are lost is looked at in
    Python, so where JAX is tracing, as under `jit` and `vmap`, `SingleShooting()` with all its grids is used alone.
    `error` [rad, lengths of the arm] is the one number that sets how accurate all of them are.
    """

    error: float = eqx.field(static=True, default=1e-8)

    @property
    def traced(self) -> SingleShooting:
        """What is used where JAX is tracing."""
        return SingleShooting(self.error)

    @property
    def methods(self) -> tuple[SingleShooting, SingleShooting, MultipleShooting, MultipleShooting]:
        """The methods, in turn."""
        return (
            SingleShooting(self.error, steps=self.traced.steps[:2]),
            SingleShooting(self.error, steps=(14, 20, 28, 40, 80), coarse_steps=6),
            MultipleShooting(error=self.error),
            MultipleShooting(intervals=256, error=self.error),
        )


@ft.lru_cache
def tableau_of(solver: diffrax.AbstractERK) -> Tableau:
    """The coefficients of a Runge-Kutta method."""
    return Tableau.of(solver)


Method = SingleShooting | MultipleShooting | Automatic


@ft.lru_cache
def methods_of(method: Method | None, *, traced: bool = False) -> tuple[SingleShooting | MultipleShooting, ...]:
    """The methods to try in turn, where JAX is tracing only one; None is `Automatic()`."""
    method = Automatic() if method is None else method
    if isinstance(method, Automatic):
        return (method.traced,) if traced else method.methods
    return (method,)


class TimeStepping(eqx.Module):
    """Adaptive integration of a TCAM in time with diffrax.

    - `solver`: any diffrax solver for ODEs. `TimeStepping.suited_to` chooses between an explicit and an implicit one.
    - `rtol`, `atol`: tolerances, of the rise of temperature in K, the contraction in lengths of the muscle, and its
      rate in lengths per swing, sqrt(m / k_o).
    - `max_steps`: the most steps between two instants before the outcome is `integration_failed`.
    - `watch`: a number of instants, equally spaced up to the last, at which temperature is looked at as well, so that
      its peak is found between the times asked for.
    """

    solver: diffrax.AbstractSolver = diffrax.Kvaerno5()
    rtol: float = eqx.field(static=True, default=1e-10)
    atol: float = eqx.field(static=True, default=1e-10)
    max_steps: int = eqx.field(static=True, default=4096)
    watch: int = eqx.field(static=True, default=1000)

    @classmethod
    def suited_to(cls, tcam: TCAM) -> "TimeStepping":
        """Tsit5 where the fastest rate of `tcam` is below 1000 / s, else Kvaerno5; Kvaerno5 while JAX traces the rate.

        Measured over 10 s of the paper's voltage (`benchmarks/tcam.py`): the paper's muscle answers at 6 / s, and Tsit5
        takes a fifth of Kvaerno5's time. At 500 / s they are even, or at 4000 / s with 1000 instants watched, which
        force short steps anyhow. At 1e5 / s, 1e4 times the paper's damping, Tsit5 takes 466000 steps and Kvaerno5
        between 20 and 200, and Tsit5 does not come through at 1e9 / s, where Kvaerno5 takes as many as ever.
        """
        rate = concrete(fastest_rate(tcam))
        return cls(diffrax.Kvaerno5() if rate is None or (rate >= _STIFF_RATE).any() else diffrax.Tsit5())
