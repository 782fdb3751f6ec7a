"""A calibration as text and JSON for the terminal."""

import json
import math

import numpy as np

from ..scene import unit_of
from ..study import Calibration
from .text import number_or_none


def calibration_json(name: str, found: Calibration) -> str:
    """One JSON object on one line; a standard error that there is none of is null."""
    rms, unit = _overall_rms(found)
    intervals = found.interval()
    line = {
        "scene": name,
        "data": [table.name for table in found.measured],
        "converged": found.converged,
        "message": found.message,
        "parameters": {
            path: {
                "value": value,
                "stderr": number_or_none(found.stderr[path]),
                "unit": unit_of(found.scene, path),
                "interval_95": [number_or_none(bound) for bound in intervals[path]],
            }
            for path, value in found.values.items()
        },
        "rms_residual": rms,
        "rms_residual_unit": unit,
        "rms": found.rms,
        "chi_squared": found.chi_squared if found.sigma_known else None,
        "chi2_per_dof": found.chi2_per_dof,
        "measurements": found.taken,
        "degrees_of_freedom": found.dof,
        "correlation": [[number_or_none(entry) for entry in row] for row in found.correlation],
        "indistinguishable": found.indistinguishable,
        "warnings": found.warnings,
        "steps": int(found.minimum.steps),
        "losses": [number_or_none(loss) for loss in np.atleast_1d(found.searches.loss)],
    }
    return json.dumps(line, allow_nan=False)


def calibration_text(name: str, found: Calibration) -> str:
    """A calibration in a few lines to read."""
    width = max(len(path) for path in found.paths)
    lines = [f"{name}: {found.message}"]
    intervals = found.interval()
    for path, value in found.values.items():
        unit, error = unit_of(found.scene, path).removesuffix("1"), found.stderr[path]
        low, high = intervals[path]
        known = f"+- {error:.2g} {unit}".rstrip() + f", 95 % in {low:.6g} to {high:.6g}"
        lines.append(f"  {path:{width}}  {value:.8g} {unit}".rstrip() + (f" {known}" if math.isfinite(error) else ""))
    for observable, rms in found.rms.items():
        lines.append(f"  rms residual of {observable}: {rms:.3g} {found.units[observable]}")
    if found.sigma_known:
        lines.append(f"  chi squared  {found.chi_squared:.4g} with {found.dof} degrees of freedom")
    return "\n".join(lines)


def _overall_rms(found: Calibration) -> tuple[float, str]:
    """Of all residuals, in SI where they have one unit, else in standard errors."""
    units = set(found.units.values())
    if len(units) == 1:
        parts = np.concatenate([residual.ravel() for residual in found.residuals])
        return float(np.sqrt(np.nanmean(parts**2))), units.pop()
    return float(np.sqrt(found.chi_squared / found.taken)), "sigma"
