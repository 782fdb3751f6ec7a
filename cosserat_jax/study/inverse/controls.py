"""What `reach` may turn: tensions, other parameters, and the constant voltage that holds a TCAM at a tension.

A TCAM that is kept under the voltage v comes to the rise T above ambient, and pulls the arm, with

    lambda(T) T = v^2 / R        tension = C_T T

(paper, Eqs. TCAMsVoltageTemperature at rest, CableTensionTCAMs). The unknown is the tension, not the voltage: the arm
does not answer to the first instant of a voltage, d(tension)/dv = 0 at v = 0, and a search that starts there would
never leave.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...physics.rod import Rod
from ...physics.section_laws import ReferenceSection
from ...physics.tcam import conductance_at, tension_gain
from ...scene import TCAM, InputError, Scene, lookup, replace, to_si, unit_of
from ..actuate import with_tensions
from ..free_parameters import Free, free_parameters

_VOLTAGE = re.compile(r"muscles\.(\d+)\.tcam\.voltage")
_TENSION = re.compile(r"muscles\.(\d+)\.tension")
_HALVINGS = 200


class Control(NamedTuple):
    """One free parameter, `free`, and the unknown that stands for it: the parameter at `path`, from `low` to `high`.

    They differ for the voltage of a TCAM, whose unknown is the tension of its muscle.
    """

    free: Free
    path: str
    low: float
    high: float
    tcam: TCAM | None = None

    def values(self, unknowns: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """The values [SI] of the parameter that the unknowns stand for."""
        return unknowns if self.tcam is None else holding_voltage(self.tcam, unknowns)


def is_voltage(path: str) -> bool:
    """Whether `path` names the voltage of a TCAM, which as a control is one number."""
    return _VOLTAGE.fullmatch(path) is not None


def unit_of_control(scene: Scene, path: str) -> str:
    """The SI unit of what is turned at `path`."""
    return "V" if is_voltage(path) else unit_of(scene, path)


def check_driven(scene: Scene, controls: Iterable[Control]) -> None:
    """Raises `InputError` for a TCAM with a voltage that is not free, whose tension would change with time."""
    free = {control.path for control in controls}
    for i, muscle in enumerate(scene.muscles):
        if muscle.tcam is not None and muscle.tcam.voltage is not None and f"muscles.{i}.tension" not in free:
            raise InputError(
                f"muscles.{i}.tcam.voltage: makes a tension that changes with time; allowed: to let it be free too, "
                "or no voltage, which is a muscle without tension"
            )


def steady_with(scene: Scene, unknowns: Mapping[str, Any]) -> Scene:
    """`scene` with these unknowns, {path: value}, in it, and no tension in the other muscles that a TCAM drives."""
    driven = {i: 0.0 for i, muscle in enumerate(scene.muscles) if muscle.tcam is not None}
    return replace(with_tensions(scene, driven), unknowns)


def controls_of(scene: Scene, free: Iterable[str] | Mapping[str, Any]) -> tuple[Control, ...]:
    """`free`, paths or {path: (lower, upper)} as for `free_parameters`, as controls with finite bounds.

    A tension without an upper bound gets `default_limit`; a voltage is bounded by the muscle's `limit_temperature`.
    Raises `InputError` for a path that cannot be turned, and for any other parameter without finite bounds.
    """
    given = dict(free) if isinstance(free, Mapping) else dict.fromkeys([free] if isinstance(free, str) else free)
    for path in given:
        matched = _TENSION.fullmatch(path)
        if matched and int(matched[1]) < len(scene.muscles) and scene.muscles[int(matched[1])].tcam is not None:
            raise InputError(f"{path}: a TCAM makes it; allowed: muscles.{matched[1]}.tcam.voltage")
    voltages = {path: _voltage_control(scene, path, bounds) for path, bounds in given.items() if is_voltage(path)}
    rest = {path: bounds for path, bounds in given.items() if path not in voltages}
    if voltages and not rest:
        return tuple(voltages.values())
    others = {one.path: _bounded(scene, one) for one in free_parameters(scene, rest, from_scene=False)}
    return tuple({**voltages, **others}[path] for path in given)


def default_limit(scene: Scene, i: int) -> float:
    """The tension [N] that by T y = EJ pi / L_i would bend the arm by half a turn, or the scene's own if that is more.

    EJ and y are the bending stiffness and the muscle's offset in the middle of the muscle, L_i its end: the arm is
    taken for a uniform one in air.
    """
    muscle, arm = scene.muscles[i], scene.arm
    end = float(arm.length if muscle.end is None else muscle.end)
    offset = 0.5 * float(muscle.base_offset + muscle.end_offset)
    rod = Rod.of(dataclasses.replace(scene, muscles=()))
    bending = float(rod.law.stiffness(ReferenceSection(0.5 * end, rod.radius_at(0.5 * end))).bending)
    half_turn = math.pi * bending / (end * offset) if offset > 0 else math.inf
    return max(half_turn, float(muscle.tension or 0.0))


def holding_voltage(tcam: TCAM, tension: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The constant voltage [V] that holds a muscle at this tension [N], v = sqrt(R lambda(T) T), T = tension / C_T."""
    return np.sqrt(_squared_voltage(tcam, np.asarray(tension) / float(tension_gain(tcam))))


def _bounded(scene: Scene, free: Free) -> Control:
    matched, upper = _TENSION.fullmatch(free.path), free.upper
    if matched and not math.isfinite(upper):
        upper = default_limit(scene, int(matched[1]))
    if not math.isfinite(free.lower) or not math.isfinite(upper):
        missing = "upper" if math.isfinite(free.lower) else "lower"
        raise InputError(f"{free.path}: has no {missing} bound; allowed: finite bounds, LOWER:UPPER {free.unit}")
    if not free.lower < upper:
        raise InputError(
            f"{free.path}: lower bound {free.lower:g} is above the limit {upper:g}; allowed: an upper bound"
        )
    return Control(free._replace(upper=upper), free.path, free.lower, upper)


def _voltage_control(scene: Scene, path: str, bounds: Any) -> Control:
    number = int(path.split(".")[1])
    tcam = scene.muscles[number].tcam if number < len(scene.muscles) else None
    if tcam is None:
        lookup(scene, path)  # raises, and says what is missing
        raise InputError(f"{path}: no such parameter")
    gain, limit = float(tension_gain(tcam)), float(tcam.limit_temperature - tcam.ambient_temperature)
    if not gain > 0:
        raise InputError(f"{path}: this muscle makes no tension; check muscles.{number}.tcam.tension_gain and its coil")
    highest = float(np.sqrt(_squared_voltage(tcam, limit)))
    if not highest > 0:
        raise InputError(f"{path}: no voltage holds a temperature; check muscles.{number}.tcam.conductance")
    lower, upper = _voltage_bounds(path, bounds, highest)
    tensions = [gain * _rise_at(tcam, voltage, limit) for voltage in (lower, upper)]
    return Control(Free(path, "V", lower, lower, upper), f"muscles.{number}.tension", tensions[0], tensions[1], tcam)


def _voltage_bounds(path: str, bounds: Any, highest: float) -> tuple[float, float]:
    low, high = (None, None) if bounds is None else bounds
    lower = 0.0 if low is None else to_si(low, "V", path)
    upper = highest if high is None else min(to_si(high, "V", path), highest)
    if not 0 <= lower < upper:
        allowed = f"a lower one of at least 0, below {highest:g} [V], which brings the muscle to its limit_temperature"
        raise InputError(f"{path}: bounds {lower:g} to {upper:g} [V] are not allowed; allowed: {allowed}")
    return lower, upper


def _squared_voltage(tcam: TCAM, rise: Any) -> Any:
    """R lambda(T) T [V^2]."""
    return float(tcam.resistance) * np.asarray(conductance_at(tcam, rise)) * rise


def _rise_at(tcam: TCAM, voltage: float, limit: float) -> float:
    """The rise T [K], up to `limit`, at which this voltage holds the muscle: by bisection."""
    if voltage**2 >= _squared_voltage(tcam, limit):
        return limit
    below, above = 0.0, limit
    for _ in range(_HALVINGS):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if _squared_voltage(tcam, middle) <= voltage**2 else (below, middle)
        if above - below <= 1e-15 * limit:
            break
    return below
