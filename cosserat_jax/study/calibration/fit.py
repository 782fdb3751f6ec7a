"""`fit`: the parameters of a scene for which it says what was measured."""

import warnings
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ...errors import quoted
from ...scene import InputError, Scene
from ...solver import Method
from ...solver.method import MultipleShooting, methods_of
from ..free_parameters import Free, Unbounded, free_parameters
from .diagnostics import doubts
from .measurements import Measurements, read_measurements
from .optimizer import minimise
from .residuals import LOSSES, Loss, bend_of, problem_of
from .result import Calibration

if TYPE_CHECKING:
    import optax

_TOLERANCE = 1e-9
_MOST_STEPS = 100  # of Levenberg-Marquardt
# From afar a robust loss hardly pulls, and has minima beside the one sought: it is searched from that of a milder one.
_MILDER: dict[str, tuple[Loss, ...]] = {
    "soft_l1": ("linear",), "huber": ("linear",), "cauchy": ("linear", "soft_l1"),
}  # fmt: skip
_MOST_UPDATES = 2000  # of an optax optimiser


def fit(
    scene: Scene,
    data: Any,
    free: Iterable[str] | Mapping[str, Any],
    *,
    sigma: Mapping[str, Any] | float | str | None = None,
    loss: Loss = "linear",
    starts: int = 1,
    seed: int = 0,
    optimiser: "optax.GradientTransformation | None" = None,
    max_steps: int | None = None,
    method: Method | None = None,
) -> Calibration:
    """The values of the `free` parameters for which `scene` says what `data` measured, by least squares,

        minimise 1/2 sum rho(r^2)        r = (value of the model - value measured) / sigma

    - `data`: a CSV file, a mapping {head: values}, a DataFrame or a Dataset, with heads such as "water.velocity [m/s]"
      and "tip.y [cm]" (see `read_measurements`); or a list of several, each an experiment of its own.
    - `free`: paths, or {path: (lower, upper)}. They start from the scene's values. Positive parameters are searched in
      their logarithm, those between two bounds as a sine, so no bound is ever crossed.
    - `sigma`: standard errors of the measurements, {name: value} or one for all, where no column gives them. Without
      any, all count alike, and their error is taken from the residuals.
    - `loss`: rho, "linear" (least squares), or robust against outliers beyond one sigma: "soft_l1", "huber", "cauchy",
      as in `scipy.optimize.least_squares`; these are searched from the minima of milder ones. Or, with an `optimiser`,
      any function of all r.
    - `starts`: so many searches in one batch, the first from the scene's values, the others from values drawn by
      chance with this `seed`; the best is given back, and the others beside it.
    - `optimiser`: an optax optimiser in place of Levenberg-Marquardt (Levenberg 1944, Marquardt 1963; optimistix).
    - `method`: as in `solve`. None tries single shooting, and multiple shooting where rods stay without equilibrium.

    A row whose rod has no equilibrium on the way counts as a misfit of ten lengths of the arm, so the search turns
    back; it never meets NaN. Columns that the scene can hardly explain are Python warnings at once. Raises
    `InputError` for data, paths, bounds or options that are not allowed. For the
    rest see `Calibration.converged`, `message` and `warnings`.
    """
    tables = data if isinstance(data, list | tuple) else [data]
    measured = tuple(read_measurements(scene, table, sigma) for table in tables)
    chosen = free_parameters(scene, free)
    _check_options(measured, chosen, loss, starts, optimiser)
    noted = doubts(scene, measured, chosen)
    for line in noted:
        warnings.warn(line, stacklevel=2)
    unbounded = Unbounded(chosen)
    begin = np.concatenate([unbounded.start()[None], unbounded.drawn(starts - 1, seed)])
    steps = max_steps or (_MOST_STEPS if optimiser is None else _MOST_UPDATES)
    solver = _solver(optimiser)

    def by(method: Method) -> Calibration:
        problem = problem_of(scene, measured, unbounded, method, loss)
        values, u = jnp.tile(problem.observed, (starts, 1)), jnp.asarray(begin)
        for milder in _MILDER.get(loss, ()) if isinstance(loss, str) else ():
            bent = eqx.tree_at(lambda problem: problem.bend, problem, bend_of(milder))
            u = minimise(bent, values, u, solver, steps).u
        found = minimise(problem, values, u, solver, steps)
        return Calibration(scene, measured, problem, found, solver, steps, noted)

    found = by(*methods_of(method, traced=True))
    harder = [each for each in methods_of(method) if isinstance(each, MultipleShooting)]
    return by(harder[0]) if found.lost_rows and method is None else found


def _solver(optimiser: Any) -> Any:
    if optimiser is None:
        return optx.IndirectLevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)
    return optx.OptaxMinimiser(optimiser, rtol=_TOLERANCE, atol=_TOLERANCE)


def _check_options(
    measured: tuple[Measurements, ...], free: tuple[Free, ...], loss: Any, starts: int, optimiser: Any
) -> None:
    for table in measured:
        for one in free:
            if one.path in table.inputs:
                raise InputError(f"{one.path} must be free or given by the data, but is a column of {table.name} too")
        if table.markers and "arm.length" in {*table.inputs, *(one.path for one in free)}:
            raise InputError("arm.length must stay where markers are measured, but changes")
    if len({table.sigma is None for table in measured}) > 1:
        raise InputError("sigma must be given in all of the tables or in none, but is missing in some")
    if isinstance(loss, str) and loss not in LOSSES:
        raise InputError(f"loss must be {', '.join(LOSSES)}, or a function of the misfits, but is {quoted(loss)}")
    if not isinstance(loss, str) and optimiser is None:
        raise InputError("loss must be a name without an optimiser, but is a function; give optimiser=optax.adam(1e-2)")
    if loss != "linear" and isinstance(loss, str) and measured[0].sigma is None:
        raise InputError(f"sigma must be given for the loss {loss!r}, which weighs misfits by it, but is missing")
    if starts < 1:
        raise InputError(f"starts must be at least 1, but is {starts}")
