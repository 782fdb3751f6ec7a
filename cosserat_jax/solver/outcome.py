"""The outcome of a solve, as data: every rod of a batch has its own."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Int


class Outcome(eqx.Enumeration):
    """Each member is a sentence that a user can act on; `Outcome[member]` is that sentence."""

    converged = "converged to the equilibrium that proportional loading reaches"
    volume_constraint_folded = (
        "the volume constraint has folded: at this load a cross-section has no scale that keeps its volume; "
        "lower the load, stiffen the arm, or use cross_section = 'rigid'"
    )
    limit_point = (
        "equilibrium is lost at a limit point before the full load is reached: the arm would snap; lower the load"
    )
    ill_conditioned = (
        "double precision loses the equilibrium, as that of a soft arm under high axial tension, for which no pose of "
        "the tip that it holds meets the base; use MultipleShooting(), as solve and sweep do outside jit and vmap, or "
        "more of its intervals"
    )
    inaccurate = (
        "the equilibrium is found, but the error of the integration is estimated above the one asked for; give more "
        "steps or a larger error"
    )
    integration_failed = (
        "the integration along the arm does not reach the base with finite numbers; give more steps, or lower the load"
    )
    iterations_exhausted = "the iterations are used up before the full load is reached; raise max_iterations"
    bad_input = "a parameter is NaN, infinite or out of its range; check the scene"
    muscles_redundant = (
        "the given tendon displacements do not tell the tensions apart: tension can be traded between these muscles "
        "without a change of length, as between two on one path; give one of them its tension instead"
    )
    not_followed = (
        "the equilibrium could not be followed up to the full load, although no limit point is in sight; use "
        "MultipleShooting() with more intervals, or more steps"
    )
    tendon_length_zero = (
        "a tendon has shrunk to zero length at a cross-section, and cannot be shortened further; lower its tension or "
        "contraction, stiffen the arm, or route it closer to the centerline"
    )


class ResponseOutcome(eqx.Enumeration):
    """The outcome of a TCAM's response over time; `ResponseOutcome[member]` is the sentence."""

    followed = "followed to the last of the times"
    overheated = (
        "the muscle is hotter than its limit temperature, beyond which it may fail; lower or shorten the voltage, or "
        "give the conductance of the water around it"
    )
    no_coil = (
        "these constants make no coil: its angle has a cosine outside 0 to 1; check fiber_length, turns, fiber_radius, "
        "the two moduli and coiling_mass"
    )
    voltage_not_resolved = (
        "the voltage, a function of time, has features too short to be seen between two instants; give its "
        "longest_step, or use Pulses, Step or Sampled, which know their jumps"
    )
    integration_failed = (
        "the integration in time did not finish; raise max_steps, loosen rtol and atol, or use an implicit solver such "
        "as diffrax.Kvaerno5()"
    )


def outcome_codes(kind: type[eqx.Enumeration] = Outcome) -> dict[str, int]:
    """The members of `Outcome`, or of `kind`, by name, each with the integer that stands for it in an array."""
    return {name: int(item._value) for name, item in kind._name_to_item.items()}


def code_of(outcome: Any) -> int:
    """The integer that stands for a member of an enumeration in an array."""
    return int(outcome._value)


def from_codes(kind: type[eqx.Enumeration], codes: Int[Array, "..."]) -> Any:
    """The members of `kind` that these integers stand for."""
    item: Any = next(iter(kind._name_to_item.values()))
    return eqx.tree_at(lambda item: item._value, item, codes)
