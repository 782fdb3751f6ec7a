"""What a solve gives back."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .display import centerlines, counted, described, fields_text, holds_numbers, notebook, shape_text, values_text
from .outcome import Outcome

if TYPE_CHECKING:
    import xarray

_POSE = {"x": "m", "y": "m", "theta": "rad"}
_STRAINS = {"nu": "", "eta": "", "mu": "1/m", "beta": ""}


class Pose(eqx.Module):
    """Place [m] and angle theta [rad] of a cross-section."""

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    theta: Float[Array, "..."]

    @described
    def __repr__(self) -> str:
        return f"Pose({fields_text(self, _POSE)})"


class SectionStrains(eqx.Module):
    """Stretch nu, shear eta, curvature mu [1/m] and in-plane stretch beta of a cross-section."""

    nu: Float[Array, "..."]
    eta: Float[Array, "..."]
    mu: Float[Array, "..."]
    beta: Float[Array, "..."]

    @described
    def __repr__(self) -> str:
        return f"SectionStrains({fields_text(self, _STRAINS)})"


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

    @described
    def __repr__(self) -> str:
        shape = np.shape(self.residual)
        if shape:
            lines = [f"Solution of {shape_text(shape)} rods: {counted(self.outcome, Outcome)}"]
        else:
            lines = [f"Solution: {self.message}"]
        lines += [f"  tip: {fields_text(self.tip, _POSE)}", f"  tip strain: {fields_text(self.tip_strain, _STRAINS)}"]
        if np.size(self.tensions):
            lines.append(f"  tensions: {values_text(self.tensions, 'N')}")
        lines.append(f"  residual: {values_text(self.residual)}, iterations: {values_text(self.iterations)}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        if not holds_numbers(self):
            return notebook(repr(self))
        return notebook(repr(self), centerlines(self.fields.x, self.fields.y))

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset of all numbers with units and long names; axes of a batch are `batch`, or `batch_0` and so on."""
        from .variables import solution_dataset

        return solution_dataset(self)

    @property
    def message(self) -> str:
        """What came of one rod, in a sentence, and for one without solution at which part of the load and where."""
        sentence = Outcome[jax.tree.map(np.asarray, self.outcome)]
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
