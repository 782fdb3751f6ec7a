"""How to solve: the integrator and the shooting method with their tolerances."""

import diffrax
import equinox as eqx

_SMALLEST_STEP = 1e-6  # of a segment: shorter steps are taken only where the section law has no solution
_LONGEST_STEP = 0.1  # of a segment: longer ones would leave the fields between two steps less accurate than the tip


class Shooting(eqx.Module):
    """Integration from tip to base with diffrax, closed by Newton, with the loads raised in steps where that is needed.

    - `solver`: any diffrax solver for ODEs.
    - `rtol`, `atol`: tolerances of the adaptive steps. The state is scaled for them by the tip section's bending
      stiffness EJ: forces by EJ / L^2, moments by EJ / L, positions by L.
    - `steps`: a number of equal steps in each segment instead of adaptive ones.
    - `max_steps`: the most steps in a segment before the outcome is `integration_failed`.
    - `newton_tol`: Newton stops after a step below this, in radians and lengths; its own error is the square of that.
    - `max_iterations`: integrations, over all load steps, before the outcome is `iterations_exhausted`.
    - `min_load_step`: fraction of the load below which a load step is given up as standing before a limit point.
    - `points`: number of equally spaced points from s = 0 to L at which the solution holds its fields.
    """

    solver: diffrax.AbstractSolver = diffrax.Dopri8()
    rtol: float = eqx.field(static=True, default=1e-9)
    atol: float = eqx.field(static=True, default=1e-9)
    steps: int | None = eqx.field(static=True, default=None)
    max_steps: int = eqx.field(static=True, default=4096)
    newton_tol: float = eqx.field(static=True, default=1e-6)
    max_iterations: int = eqx.field(static=True, default=200)
    min_load_step: float = eqx.field(static=True, default=1e-4)
    points: int = eqx.field(static=True, default=101)

    @property
    def controller(self) -> diffrax.AbstractStepSizeController:
        """The step-size controller that these tolerances ask for."""
        if self.steps is not None:
            return diffrax.ConstantStepSize()
        return diffrax.PIDController(
            rtol=self.rtol, atol=self.atol, dtmin=_SMALLEST_STEP, dtmax=_LONGEST_STEP, force_dtmin=False
        )
