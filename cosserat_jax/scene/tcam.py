"""A twisted and coiled artificial muscle: its constants, and the voltage that heats it."""

from collections.abc import Callable
from typing import Literal

import equinox as eqx

from .quantity import NOT_NEGATIVE, POSITIVE, Scalar, as_pytree, choice, part, quantity
from .voltage import KINDS, AbstractVoltage, as_voltage

ZERO_CELSIUS = 273.15  # K


class LinearConductance(eqx.Module):
    """A conductance that grows with the rise T above ambient: adds `slope` [W/K^2] times T."""

    slope: Scalar = quantity("W/K^2")

    def __call__(self, rise: Scalar) -> Scalar:
        return self.slope * rise


class TCAM(eqx.Module):
    """A twisted and coiled artificial muscle. The defaults are the paper's Table I, those marked * are our assumptions.

    Heating
    - `voltage`: what drives it, a `Sinusoid`, `Step`, `Pulses`, `Sampled`, a diffrax interpolation or any function of
      time; None: nothing.
    - `resistance` [ohm], `thermal_mass` C_t [J/K], `ambient_temperature` [K].
    - `conductance` lambda [W/K] to what surrounds it. The paper's value is one in still air. Water carries heat away
      10 to 1000 times faster: for a muscle that touches water give its own value, or it will seem far too hot.
    - `conductance_law`: None, or a function of the rise T [K] that is added to `conductance`, such as
      `LinearConductance`.
    - `limit_temperature` [K]*: above it the outcome is `overheated`. The paper warns of malfunction beyond a threshold
      that it does not name; ours is 150 degC.

    Coil
    - `fiber_length` S [m] and `turns` n of the twisted fiber, `fiber_radius` r_o [m] at ambient temperature, its radial
      `expansion` alpha [1/K], `axial_modulus` E_x and `shear_modulus` G_yz [Pa].
    - `coiling_mass` m_bar [kg]: hung on the fiber while it was coiled; `gravity` [m/s^2].

    Motion
    - `mass` m [kg] that moves, and `hanging_mass` [kg] whose weight pulls: None is `coiling_mass`, the paper's case.
    - `damping` b [N s/m]; None*: critical, 2 sqrt(m k_o), for the paper gives no value.
    - `dynamics`: "linearised" (drive C_T T) or "full" (stiffness k(T)). `mounting`: "hanging" from its mass, or
      "isometric", held at the length it has at ambient temperature.
    - `tension_gain` C_T [N/K], the tension per degree with which it pulls an arm. None: that of the formulas at
      `reference_temperature` [K]*; see `gain_from_formulas` and `gain_from_measurement`. The linearised motion of the
      muscle itself takes that of the formulas in any case.
    """

    voltage: AbstractVoltage | None = part(KINDS, default=None, converter=as_voltage)
    resistance: Scalar = quantity("ohm", POSITIVE, default=18.0)
    thermal_mass: Scalar = quantity("J/K", POSITIVE, default=0.162)
    conductance: Scalar = quantity("W/K", NOT_NEGATIVE, default=0.0086)
    conductance_law: Callable[[Scalar], Scalar] | None = part(
        {"linear": LinearConductance}, default=None, converter=as_pytree
    )
    ambient_temperature: Scalar = quantity("K", NOT_NEGATIVE, default=23 + ZERO_CELSIUS)
    limit_temperature: Scalar = quantity("K", POSITIVE, default=150 + ZERO_CELSIUS)
    fiber_length: Scalar = quantity("m", POSITIVE, default=0.46)
    turns: Scalar = quantity("1", POSITIVE, default=200.0)
    fiber_radius: Scalar = quantity("m", POSITIVE, default=3.6e-4)
    expansion: Scalar = quantity("1/K", default=3e-4)
    axial_modulus: Scalar = quantity("Pa", POSITIVE, default=4.67e8)
    shear_modulus: Scalar = quantity("Pa", POSITIVE, default=2.2e7)
    coiling_mass: Scalar = quantity("kg", POSITIVE, default=0.106)
    gravity: Scalar = quantity("m/s^2", POSITIVE, default=9.81)
    mass: Scalar = quantity("kg", POSITIVE, default=0.106)
    hanging_mass: Scalar | None = quantity("kg", NOT_NEGATIVE, default=None)
    damping: Scalar | None = quantity("N*s/m", NOT_NEGATIVE, default=None)
    tension_gain: Scalar | None = quantity("N/K", NOT_NEGATIVE, default=None)
    reference_temperature: Scalar = quantity("K", POSITIVE, default=98 + ZERO_CELSIUS)
    dynamics: Literal["linearised", "full"] = choice("linearised", "full", default="linearised")
    mounting: Literal["hanging", "isometric"] = choice("hanging", "isometric", default="hanging")
