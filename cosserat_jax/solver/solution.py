"""What a solve gives back."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .outcome import Outcome


class Pose(eqx.Module):
    """Place [m] and angle theta [rad] of a cross-section."""

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    theta: Float[Array, "..."]

    def __repr__(self) -> str:
        return _with_units(self, {"x": "m", "y": "m", "theta": "rad"})


class SectionStrains(eqx.Module):
    """Stretch nu, shear eta, curvature mu [1/m] and in-plane stretch beta of a cross-section."""

    nu: Float[Array, "..."]
    eta: Float[Array, "..."]
    mu: Float[Array, "..."]
    beta: Float[Array, "..."]

    def __repr__(self) -> str:
        return _with_units(self, {"nu": "", "eta": "", "mu": "1/m", "beta": ""})


class Fields(eqx.Module):
    """The equilibrium along the arm, at arc lengths `s` [m] of the undeformed centerline from the base to the tip.

    `x`, `y` [m], `theta` [rad], the strains `nu`, `eta`, `mu` [1/m], `beta`, and the paper's tractions
    N = c E (nu - 1) [Pa], H = c G eta [Pa] and bending moment M = c E mu [Pa/m], the internal force and moment of the
    section over its deformed A and J (paper, Eqs. BulkContactForceFcConstitutive, BulkContactMomentMcConstitutive).
    `force_x`, `force_y` [N] and `moment` [N m] are the totals that the section and the muscles through it carry;
    at s = 0 they are what the clamp holds. At the end of a muscle the strains are those of the side of the base.
    """

    s: Float[Array, "... points"]
    x: Float[Array, "... points"]
    y: Float[Array, "... points"]
    theta: Float[Array, "... points"]
    nu: Float[Array, "... points"]
    eta: Float[Array, "... points"]
    mu: Float[Array, "... points"]
    beta: Float[Array, "... points"]
    N: Float[Array, "... points"]
    H: Float[Array, "... points"]
    M: Float[Array, "... points"]
    force_x: Float[Array, "... points"]
    force_y: Float[Array, "... points"]
    moment: Float[Array, "... points"]


class Solution(eqx.Module):
    """The equilibrium of a scene and what it took to find it; every array has leading axes where the scene was batched.

    - `tip` [m, m, rad], `tip_strain`, `fields` over s: NaN for a rod that has no solution.
    - `outcome`: an `Outcome`; `Outcome[solution.outcome]` is its sentence.
    - `residual`: error of the clamp at s = 0, the largest of the angle [rad] and the place in lengths of the arm; and
      of given tendon displacements, over the lever of the muscle (see `physics.tendon`).
      With multiple shooting, if it is larger, the largest gap between two intervals.
    - `error`: estimated, of the tip's pose, from the difference between two numbers of steps [rad, lengths].
    - `condition`: max(1, |A|) max(1, |A^-1|), A the Jacobian of the equation that clamps the base. In single shooting A
      is d(pose of the base)/d(pose of the tip): as many of the 16 digits are lost as this has. Large where the tip's
      pose is amplified, as in an arm pulled taut, and near a limit point.
    - `iterations`: integrations with their Jacobian, over all load steps. `steps`: of the last integration.
    - `load_fraction`: the part of the load up to which the equilibrium was followed; 1 where converged.
    - `failed_at`: arc length s [m] at which the volume constraint folded or the integration stopped, else NaN.
    - `tensions` [N] of all muscles, those given and those found from a tendon displacement; 0 is slack. NaN without a
      solution.
    """

    tip: Pose
    tip_strain: SectionStrains
    fields: Fields
    outcome: Outcome
    residual: Float[Array, "..."]
    error: Float[Array, "..."]
    condition: Float[Array, "..."]
    iterations: Int[Array, "..."]
    steps: Int[Array, "..."]
    load_fraction: Float[Array, "..."]
    failed_at: Float[Array, "..."]
    tensions: Float[Array, "... muscles"]

    def __repr__(self) -> str:
        if isinstance(self.outcome._value, Tracer) or jnp.ndim(self.outcome._value) > 0:
            return f"Solution({jnp.shape(self.residual)} rods, tip {self.tip})"
        tensions = f"\n  tensions {_values(self.tensions, 'N')}" if self.tensions.size else ""
        return f"Solution: {self.message}\n  tip {self.tip}\n  tip strain {self.tip_strain}{tensions}"

    @property
    def message(self) -> str:
        """What came of one rod, in a sentence, and for one without solution at which part of the load and where."""
        sentence = Outcome[self.outcome]
        if bool(self.converged):
            return sentence
        place = "" if jnp.isnan(self.failed_at) else f", at s = {float(self.failed_at):.3g} m"
        return f"{sentence} (reached {float(self.load_fraction):.3g} of the load{place})"

    @property
    def converged(self) -> Bool[Array, "..."]:
        """Whether the equilibrium was found."""
        return self.outcome == Outcome.converged

    @property
    def tilt(self) -> Float[Array, "..."]:
        """alpha - theta at the tip [rad]: the angle from the cross-section's director a to the centerline's tangent."""
        return jnp.arctan2(self.tip_strain.eta, self.tip_strain.nu)


def _with_units(part: Any, units: dict[str, str]) -> str:
    """The fields of a part as "x 0.379133 m, y ..."."""
    return ", ".join(f"{name} {_values(getattr(part, name), unit)}" for name, unit in units.items())


def _values(values: Any, unit: str) -> str:
    """Numbers with their unit; of many their range, of what JAX traces its kind."""
    if isinstance(values, Tracer) or not eqx.is_array_like(values):
        return str(values)
    array = np.asarray(values)
    if array.size <= 4:
        text = " and ".join(f"{number:.6g}" for number in array.ravel())
    else:
        finite = array[np.isfinite(array)]
        text = f"{finite.min():.6g} to {finite.max():.6g}" if finite.size else "nan"
    return f"{text} {unit}".rstrip()
