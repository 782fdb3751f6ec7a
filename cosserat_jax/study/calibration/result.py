"""What comes back from a fit: values, and how well the data know them."""

import dataclasses
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...scene import Scene, replace, unit_of
from ...solver.display import data_against_model, described, holds_numbers, notebook
from .measurements import Measurements
from .optimizer import Minimum
from .residuals import Problem
from .uncertainty import Uncertainty, not_told_apart, uncertainty

_SETTLED = 1e-3  # of a standard error: what one more step would still move
_EXACT = 1e-7  # misfit, in units of sigma or of the data's spread, that counts as none
_NO_MISFIT = 1e-6  # of chi squared for each degree of freedom: data without noise
_RARE, _FAR = 1e-3, 2.0  # chance of a chi squared, and its distance from 1, of which to warn
_OUTLYING = 6.0  # standard errors
_HARDLY_PULLED = 3.0  # sigma
_AT_BOUND = 1e-3  # of the way from one bound to the other


@dataclasses.dataclass(frozen=True)
class Calibration:
    """A fitted scene, from `fit`. Parameters go by path, and all numbers are in SI.

    - `values`, `stderr`: of each free parameter; the error is infinite where the data know nothing of it, and NaN for
      one that stands at a bound.
    - `fitted`: the scene with these values in it, which runs, and which `dumps` writes as a file.
    - `converged`, `message`, `warnings`: whether this is a minimum; rows without equilibrium, parameters that stand at
      a bound, or that the data cannot tell apart; misfits that sigma does not explain, outliers. `noted`: those that
      were known before the search.
    - `searches`: where each start ended; `minimum` is that of the smallest loss.
    - `measured`, `predicted`, `residuals`: one for each table of data.
    """

    scene: Scene
    measured: tuple[Measurements, ...]
    problem: Problem
    searches: Minimum
    solver: Any
    max_steps: int
    noted: tuple[str, ...] = ()

    def _text(self) -> str:
        lines = [f"Calibration: {self.message}"]
        for path, value in self.values.items():
            number = f"{value:.6g} +- {self.stderr[path]:.2g} {unit_of(self.scene, path)}".removesuffix(" 1")
            lines.append(f"  {path}: {number}")
        lines += [f"  rms residual of {name}: {rms:.3g} {self.units[name]}" for name, rms in self.rms.items()]
        return "\n".join(lines + [f"  warning: {line}" for line in self.warnings])

    __repr__ = described(_text, ("searches",))

    def _repr_html_(self) -> str:
        if not holds_numbers(self.searches):
            return notebook(repr(self))
        columns: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for table, said in zip(self.measured, self.predicted, strict=True):
            for one, measured, predicted in zip(table.observables, table.values.T, said.T, strict=True):
                columns.setdefault(one.name, []).append((measured, predicted))
        panels = [
            (
                f"{name} [{self.units[name]}]",
                np.concatenate([part[0] for part in parts]),
                np.concatenate([part[1] for part in parts]),
            )
            for name, parts in columns.items()
        ]
        return notebook(f"{self!r}\n  predicted (up) against measured:", data_against_model(panels))

    @cached_property
    def minimum(self) -> Minimum:
        """Where the best search ended."""
        best = int(jnp.argmin(self.searches.loss))
        return jax.tree.map(lambda leaf: leaf[best], self.searches)

    @property
    def paths(self) -> tuple[str, ...]:
        """Of the free parameters: the order of rows and columns of `correlation`."""
        return tuple(one.path for one in self.problem.unbounded.free)

    @cached_property
    def values(self) -> dict[str, float]:
        """Of the free parameters."""
        return {path: float(value) for path, value in self.problem.unbounded.values(self.minimum.u).items()}

    @cached_property
    def fitted(self) -> Scene:
        """The scene with the values found."""
        return replace(self.scene, self.values)

    @cached_property
    def at_bound(self) -> dict[str, float]:
        """Parameters that the data push against a bound: that bound, by path."""
        found = {}
        for one, value in zip(self.problem.unbounded.free, self.values.values(), strict=True):
            near = _AT_BOUND * (one.upper - one.lower)
            if not np.isfinite(near):
                near = 1e-6 * abs(one.start - (one.lower if np.isfinite(one.lower) else one.upper))
            for bound in (one.lower, one.upper):
                if abs(value - bound) < near:
                    found[one.path] = bound
        return found

    @property
    def sigma_known(self) -> bool:
        """Whether the standard errors of the measurements were given; else they are taken from the residuals."""
        return self.measured[0].sigma is not None

    @property
    def taken(self) -> int:
        """How many values were measured."""
        return int(np.sum(~np.isnan(self.problem.observed)))

    @property
    def dof(self) -> int:
        """Degrees of freedom: measurements less parameters that are not at a bound."""
        return self.taken - len(self._inside)

    @property
    def noise(self) -> float:
        """Standard error of a misfit: 1 where sigma is known, else estimated from all of them."""
        return 1.0 if self.sigma_known else float(np.sqrt(self.chi_squared / max(self.dof, 1)))

    @cached_property
    def uncertainty(self) -> Uncertainty:
        """Of the parameters that are not at a bound."""
        jacobian = self.minimum.jacobian / self.problem.unbounded.slopes(self.minimum.u)[None]
        return uncertainty(jacobian[:, self._inside], self.minimum.misfits, self.taken, self.sigma_known)

    @cached_property
    def stderr(self) -> dict[str, float]:
        """Standard errors from the Jacobian, Laplace's approximation; see `Uncertainty`."""
        known = dict(zip(self._inside, np.asarray(self.uncertainty.stderr), strict=True))
        return {path: float(known.get(i, np.nan)) for i, path in enumerate(self.paths)}

    @cached_property
    def correlation(self) -> np.ndarray:
        """Of the parameters' errors, in the order of `paths`; NaN for one at a bound."""
        full = np.full((len(self.paths),) * 2, np.nan)
        full[np.ix_(self._inside, self._inside)] = self.uncertainty.correlation
        return full

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Confidence intervals, value -+ t stderr, with Student's t where sigma is estimated from the residuals."""
        from scipy.special import ndtri, stdtrit  # here, not above: it takes long to import

        tail = (1 + level) / 2
        t = float(ndtri(tail) if self.sigma_known else stdtrit(max(self.dof, 1), tail))
        return {
            path: (value - t * self.stderr[path], value + t * self.stderr[path]) for path, value in self.values.items()
        }

    @cached_property
    def predicted(self) -> list[np.ndarray]:
        """What the fitted scene says, rows by observables; NaN in a row without equilibrium."""
        ends = np.cumsum([table.values.size for table in self.measured])[:-1]
        parts = np.split(np.asarray(self.minimum.predicted), ends)
        return [part.reshape(table.values.shape) for part, table in zip(parts, self.measured, strict=True)]

    @cached_property
    def residuals(self) -> list[np.ndarray]:
        """Predicted less measured, rows by observables; NaN where nothing was measured."""
        return [said - table.values for said, table in zip(self.predicted, self.measured, strict=True)]

    @cached_property
    def units(self) -> dict[str, str]:
        """Of the observables, by name."""
        return {one.name: one.unit for table in self.measured for one in table.observables}

    @cached_property
    def rms(self) -> dict[str, float]:
        """Root of the mean square of the residuals of each observable, over all tables."""
        columns: dict[str, list[np.ndarray]] = {}
        for table, residual in zip(self.measured, self.residuals, strict=True):
            for observable, column in zip(table.observables, residual.T, strict=True):
                columns.setdefault(observable.name, []).append(column)
        return {name: float(np.sqrt(np.nanmean(np.concatenate(parts) ** 2))) for name, parts in columns.items()}

    @property
    def chi_squared(self) -> float:
        """Sum of squares of residual / sigma; where sigma is not known, of residual / spread of the data."""
        return float(jnp.sum(self.minimum.misfits**2))

    @property
    def history(self) -> np.ndarray:
        """The loss after each step of the best search."""
        return np.asarray(self.minimum.history)[: int(self.minimum.steps)]

    @cached_property
    def lost_rows(self) -> list[tuple[str, int]]:
        """Rows that were measured and have no equilibrium at the values found: table and number, from 1."""
        return [
            (table.name, int(row) + 1)
            for table, said in zip(self.measured, self.predicted, strict=True)
            for row in np.flatnonzero((np.isnan(said) & ~np.isnan(table.values)).any(axis=1))
        ]

    @cached_property
    def converged(self) -> bool:
        """Whether one more step would move no parameter by a thousandth of its standard error, and no row is lost."""
        jacobian = np.asarray(self.minimum.jacobian)[:, self._inside]
        lengths = np.linalg.norm(jacobian, axis=0)
        jacobian = jacobian / np.where(lengths > 0, lengths, 1.0)
        step, *_ = np.linalg.lstsq(jacobian, np.asarray(self.minimum.misfits))
        settled = np.linalg.norm(jacobian @ step) < max(_SETTLED * self.noise, _EXACT * np.sqrt(self.taken))
        return bool(settled) and not self.lost_rows

    @property
    def message(self) -> str:
        """What came of it, in a sentence."""
        steps = int(self.minimum.steps)
        if self.lost_rows:
            table, row = self.lost_rows[0]
            return (
                f"{len(self.lost_rows)} rows have no equilibrium at the best values found, first row {row} of {table}; "
                "start from other values, or narrow the bounds"
            )
        if not self.converged:
            return f"no minimum after {steps} steps; raise max_steps, or start from other values"
        return f"converged in {steps} steps"

    @cached_property
    def indistinguishable(self) -> list[tuple[str, ...]]:
        """Sets of parameters that the data cannot tell apart, worst first; see `Uncertainty`."""
        inside = [self.paths[i] for i in self._inside]
        return [tuple(inside[i] for i in members) for members in not_told_apart(self.uncertainty)]

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting the values, a sentence each."""
        lines = [
            *self.noted,
            *self._misfit_lines(),
        ]
        lines += [
            f"{path} stands at its bound, {bound:g}, and has no standard error" for path, bound in self.at_bound.items()
        ]
        lines += [
            f"the data cannot tell apart {' and '.join(paths)}; fix one of them, or measure something else as well"
            for paths in self.indistinguishable
        ]
        lines += [f"the data know nothing of {path}" for path, error in self.stderr.items() if np.isinf(error)]
        if self.dof < 1 and not self.sigma_known:
            count = f"{self.taken} measurements for {len(self._inside)} parameters"
            lines.append(f"{count} leave no residual to take a standard error from; give sigma")
        return tuple(lines)

    @property
    def chi2_per_dof(self) -> float | None:
        """Sum of squares of residual / sigma for each degree of freedom; None where sigma is not known."""
        return float(np.sum(self._deviations**2)) / self.dof if self.sigma_known and self.dof > 0 else None

    def _misfit_lines(self) -> list[str]:
        """Where the residuals are not what sigma, or the others among them, promise."""
        lines, deviations = [], np.abs(self._deviations)
        linear = int(self.problem.bend) == 0 and self.problem.rho is None
        per_dof = self.chi2_per_dof
        if linear and per_dof is not None and per_dof > _NO_MISFIT:
            from scipy.special import chdtr, chdtrc  # here, not above: it takes long to import

            chance = min(chdtr(self.dof, per_dof * self.dof), chdtrc(self.dof, per_dof * self.dof))
            if chance < _RARE and not 1 / _FAR < per_dof < _FAR:
                what = (
                    "the scene does not explain the data, or sigma is too small"
                    if per_dof > 1
                    else "sigma is too large"
                )
                lines.append(f"chi squared is {per_dof:.3g} for each degree of freedom, far from 1: {what}")
        if not linear and self.sigma_known and np.median(deviations) > _HARDLY_PULLED:
            lines.append(
                f"half of the measurements lie more than {np.median(deviations):.3g} sigma off, where a robust loss "
                "hardly pulls: it may have stopped far from the minimum"
            )
        scale = 1.0 if self.sigma_known else 1.4826 * float(np.median(deviations))
        far = np.flatnonzero(deviations > _OUTLYING * scale)
        if linear and 0 < far.size <= self.taken / 3 and np.sqrt(np.mean(deviations**2)) > _EXACT:
            worst = far[np.argmax(deviations[far])]
            lines.append(
                f"{far.size} of {self.taken} measurements are outliers, {self._name_of(int(worst))} by "
                f"{deviations[worst] / scale:.3g} standard errors; check them, or give sigma and loss='soft_l1'"
            )
        return lines

    @cached_property
    def _deviations(self) -> Float[np.ndarray, " taken"]:
        """Residual / sigma of what was measured, as no loss has bent it; 0 in a row without equilibrium."""
        taken = ~np.isnan(self.problem.observed)
        off = (np.asarray(self.minimum.predicted) - self.problem.observed) / self.problem.sigma
        return np.nan_to_num(np.asarray(off)[taken])

    def _name_of(self, number: int) -> str:
        """What and where the measurement of this number among those taken is."""
        i = int(np.flatnonzero(~np.isnan(self.problem.observed))[number])
        for table in self.measured:
            if i < table.values.size:
                row, column = divmod(i, len(table.observables))
                return f"{table.observables[column].name} in row {row} of {table.name}"
            i -= table.values.size
        raise AssertionError("every measurement is in a table")

    @property
    def _inside(self) -> list[int]:
        """The numbers of the parameters that are not at a bound."""
        return [i for i, path in enumerate(self.paths) if path not in self.at_bound]
