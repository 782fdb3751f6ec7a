"""How to solve: the integrators with their tolerances, along the arm and in time, and the shooting method."""

import dataclasses

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float, PyTree

from ..physics.tcam import fastest_rate
from ..scene import TCAM
from ..scene.quantity import concrete

_SMALLEST_STEP = 1e-6  # of a segment: shorter steps are taken only where the section law has no solution
_STIFF_RATE = 1000.0  # 1 / s; see `TimeStepping.suited_to`
_LONGEST_STEP = 0.1  # of a segment: longer ones would leave the fields between two steps less accurate than the tip
_INTERVALS = 64  # of multiple shooting
_PATIENCE = 60  # iterations of single shooting: what takes longer is mostly beyond it
_FIRST_STEP = 0.1  # of a segment; choosing it from the equations would compile them twice more


def error_norm(errors: PyTree) -> Float[Array, ""]:
    """Root mean square, infinite instead of NaN: a state that is NaN from the start is given up after a few ever
    shorter steps, where diffrax would take all that it may, and a whole batch would wait for it."""
    size = optimistix.rms_norm(errors)
    return jnp.where(jnp.isnan(size), jnp.inf, size)


class Shooting(eqx.Module):
    """Integration from tip to base with diffrax, closed by Newton, with the loads raised in steps where that is needed.

    - `solver`: any diffrax solver for ODEs.
    - `rtol`, `atol`: tolerances of the adaptive steps. The state is scaled for them by the bending stiffness EJ of the
      section where a segment starts: forces by EJ / L^2, moments by EJ / L, positions by L.
    - `steps`: a number of equal steps in each segment instead of adaptive ones.
    - `intervals`: 1 is single shooting, whose unknown is the pose of the tip (and the tension of every muscle whose
      contraction is given, in all that follows). More is multiple shooting, which cuts the
      arm into that many intervals, short where its state changes fast, with the state at every cut unknown: slower, and
      not impressed by an arm pulled taut. None is single shooting, and multiple shooting with 64 intervals for a rod
      that single shooting did not solve; the choice is made in Python, so it asks for values that JAX is not tracing:
      under `jit` and `vmap`, None is 1. (`sweep` and `actuate` choose for each rod.)
    - `max_steps`: the most steps in a segment before the outcome is `integration_failed`.
    - `newton_tol`: Newton stops after a step below this, in radians and lengths; its own error is the square of that.
    - `max_iterations`: integrations, over all load steps, before the outcome is `iterations_exhausted`.
    - `min_load_step`: fraction of the load reached below which a load step is given up as standing before a limit.
    - `points`: at which points the solution holds its fields: a number of equally spaced ones from s = 0 to L, or a
      tuple of their places s / L, ascending from 0 to 1.

    The default, Dopri8 (Prince & Dormand 1981) with adaptive steps at 1e-9, is chosen from error against run time
    (`benchmarks/error_vs_runtime.py`: four scenes, one rod and 64, ten kinds of steps). It leaves errors of 1e-12 to
    6e-10 lengths in the tip and 2e-10 to 6e-9 in the fields, and no run that left no more took less than 0.62 of its
    time. Tsit5 or Dopri5 at 1e-7 take a third to over half of it for errors of 2e-8 to 2e-6 in the fields. The implicit
    Kvaerno5 takes over ten times as long at equal error, and four times as long to compile.
    """

    solver: diffrax.AbstractSolver = diffrax.Dopri8()
    rtol: float = eqx.field(static=True, default=1e-9)
    atol: float = eqx.field(static=True, default=1e-9)
    steps: int | None = eqx.field(static=True, default=None)
    intervals: int | None = eqx.field(static=True, default=None)
    max_steps: int = eqx.field(static=True, default=4096)
    newton_tol: float = eqx.field(static=True, default=1e-6)
    max_iterations: int = eqx.field(static=True, default=400)
    min_load_step: float = eqx.field(static=True, default=1e-4)
    points: int | tuple[float, ...] = eqx.field(static=True, default=101)

    @property
    def places(self) -> Float[np.ndarray, " points"]:
        """The places s / L of the points."""
        return np.linspace(0.0, 1.0, self.points) if isinstance(self.points, int) else np.array(self.points)

    @property
    def is_multiple(self) -> bool:
        """Whether the arm is cut into intervals."""
        return self.intervals is not None and self.intervals > 1

    @property
    def single(self) -> "Shooting":
        """The same by single shooting, which does not try for long where multiple shooting can follow."""
        patience = min(self.max_iterations, _PATIENCE)
        return self if self.intervals is not None else dataclasses.replace(self, intervals=1, max_iterations=patience)

    @property
    def multiple(self) -> "Shooting":
        """The same by multiple shooting, for a rod that single shooting did not solve."""
        return dataclasses.replace(self, intervals=_INTERVALS)

    @property
    def first_step(self) -> float:
        """The length of the first step tried, of a segment or interval."""
        if self.steps is not None:
            return 1.0 / self.steps
        return 1.0 if self.is_multiple else _FIRST_STEP

    @property
    def controller(self) -> diffrax.AbstractStepSizeController:
        """The step-size controller that these tolerances ask for."""
        if self.steps is not None:
            return diffrax.ConstantStepSize()
        longest = None if self.is_multiple else _LONGEST_STEP
        return diffrax.PIDController(
            rtol=self.rtol, atol=self.atol, dtmin=_SMALLEST_STEP, dtmax=longest, force_dtmin=False, norm=error_norm
        )


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
