"""The physics of a twisted and coiled artificial muscle: voltage to temperature, to coil, to force.

T is the rise of temperature above ambient [K]. Sources: paper, section TCAMs Actuation Model; the coil after Lamuta et
al. (2018) and Weerakkody et al. (2023), the heat balance after Yip & Niemeyer (2015), the damping after Kato et al.
"""

from typing import NamedTuple

import jax.numpy as jnp

from ..scene import TCAM
from ..scene.quantity import Scalar


class TCAMState(NamedTuple):
    """Rise of temperature T [K], contraction d = L_o - length [m] and its rate [m/s]."""

    rise: Scalar
    contraction: Scalar
    rate: Scalar


def conductance_at(tcam: TCAM, rise: Scalar) -> Scalar:
    """lambda(T) [W/K], the heat that leaves per degree of the rise."""
    return tcam.conductance + (0.0 if tcam.conductance_law is None else jnp.vectorize(tcam.conductance_law)(rise))


def heating_rate(tcam: TCAM, voltage: Scalar, rise: Scalar) -> Scalar:
    """dT/dt = (v^2 / R - lambda(T) T) / C_t [K/s] (paper, Eq. TCAMsVoltageTemperature)."""
    return (voltage**2 / tcam.resistance - conductance_at(tcam, rise) * rise) / tcam.thermal_mass


def fiber_radius(tcam: TCAM, rise: Scalar) -> Scalar:
    """r = r_o (1 + alpha T) [m] (paper, Eq. TCAMsRadiusTemperature)."""
    return tcam.fiber_radius * (1 + tcam.expansion * rise)


def bending_stiffness(tcam: TCAM, rise: Scalar) -> Scalar:
    """B = E_x pi r^4 / 4 [N m^2] of the fiber (paper, Eq. TCAMsBendingTorsionStiffness)."""
    return tcam.axial_modulus * jnp.pi / 4 * fiber_radius(tcam, rise) ** 4


def torsional_stiffness(tcam: TCAM, rise: Scalar) -> Scalar:
    """C = G_yz pi r^4 / 2 [N m^2] of the fiber (paper, Eq. TCAMsBendingTorsionStiffness)."""
    return tcam.shear_modulus * jnp.pi / 2 * fiber_radius(tcam, rise) ** 4


def coil_cosine(tcam: TCAM, rise: Scalar) -> Scalar:
    """cos(coil angle) = 1 - (q B C / sqrt(B m_bar g) - 2 C) / (B - C), with q = 2 pi n / S.

    Paper, Eq. TCAMsCoilAngleBeta, which prints sqrt(B) m_bar g; only sqrt(B m_bar g) has the dimension of the rest.
    Outside 0 to 1 the constants make no coil.
    """
    b, c = bending_stiffness(tcam, rise), torsional_stiffness(tcam, rise)
    twist = 2 * jnp.pi * tcam.turns / tcam.fiber_length
    return 1 - (twist * b * c / jnp.sqrt(b * coiling_weight(tcam)) - 2 * c) / (b - c)


def coil_angle(tcam: TCAM, rise: Scalar) -> Scalar:
    """The angle of the coil [rad] from the muscle's axis: `arccos` of `coil_cosine`."""
    return jnp.arccos(coil_cosine(tcam, rise))


def coiled_length(tcam: TCAM, rise: Scalar) -> Scalar:
    """length = S cos(coil angle) [m] under the coiling mass (paper, Eq. TCAMsLength)."""
    return tcam.fiber_length * coil_cosine(tcam, rise)


def spring_coefficient(tcam: TCAM, rise: Scalar) -> Scalar:
    """k = m_bar g / length [N/m] (paper, Eq. TCAMsSpringStiffnessK)."""
    return coiling_weight(tcam) / coiled_length(tcam, rise)


def coiling_weight(tcam: TCAM) -> Scalar:
    """m_bar g [N]."""
    return tcam.coiling_mass * tcam.gravity


def hanging_weight(tcam: TCAM) -> Scalar:
    """F_e [N]: the weight of the hanging mass."""
    return coiling_weight(tcam) if tcam.hanging_mass is None else tcam.hanging_mass * tcam.gravity


def damping_coefficient(tcam: TCAM) -> Scalar:
    """b [N s/m]: what the muscle was given, else critical, 2 sqrt(m k_o), which is our assumption."""
    return 2 * jnp.sqrt(tcam.mass * spring_coefficient(tcam, 0.0)) if tcam.damping is None else tcam.damping


def damping_from_viscosity(viscosity: Scalar, section_area: Scalar, length: Scalar) -> Scalar:
    """b = eta A_s / length [N s/m] of a Kelvin-Voigt muscle, eta in Pa s (paper, Eq. TCAMsViscosityCoefficient)."""
    return viscosity * section_area / length


def tension_gain(tcam: TCAM) -> Scalar:
    """C_T [N/K] of the pull on an arm: what the muscle was given, else `gain_from_formulas` at its reference."""
    if tcam.tension_gain is not None:
        return tcam.tension_gain
    return gain_from_formulas(tcam, tcam.reference_temperature)


def gain_from_formulas(tcam: TCAM, temperature: Scalar) -> Scalar:
    """C_T = k_o d* / T* [N/K], with d* = L_o - length(T*) and T* the rise to `temperature` [K].

    Paper, Eq. CoefficentC_TCAMs. With the paper's constants 8.45e-4 N/K at T* = 75 K: 0.063 N at 98 degC, not the 25 N
    that the paper shows.
    """
    rise = temperature - tcam.ambient_temperature
    return spring_coefficient(tcam, 0.0) * (coiled_length(tcam, 0.0) - coiled_length(tcam, rise)) / rise


def gain_from_measurement(force: Scalar, temperature: Scalar, ambient_temperature: Scalar) -> Scalar:
    """C_T = force / (temperature - ambient_temperature) [N/K] from one measured force [N] and temperature [K]."""
    return force / (temperature - ambient_temperature)


def driving_force(tcam: TCAM, rise: Scalar) -> Scalar:
    """What heat adds to the pull of a muscle held at its ambient length [N]: C_T T, or in full (k(T) - k_o) L_o.

    C_T is here that of the formulas, whatever `tension_gain` was measured: with the paper's 25 N at 98 degC its own
    equation of motion would contract a fiber of 0.46 m by 5.7 m.
    """
    if tcam.dynamics == "linearised":
        return gain_from_formulas(tcam, tcam.reference_temperature) * rise
    return (spring_coefficient(tcam, rise) - spring_coefficient(tcam, 0.0)) * coiled_length(tcam, 0.0)


def resting_state(tcam: TCAM) -> TCAMState:
    """At ambient temperature and at rest, a hanging muscle stretched by what its mass exceeds the coiling mass."""
    if tcam.mounting == "isometric":
        return TCAMState(0.0, 0.0, 0.0)
    stretch = (hanging_weight(tcam) - coiling_weight(tcam)) / spring_coefficient(tcam, 0.0)
    return TCAMState(0.0, jnp.where(jnp.isfinite(stretch), -stretch, 0.0), 0.0)  # not finite where there is no coil


def state_rate(tcam: TCAM, voltage: Scalar, state: TCAMState) -> TCAMState:
    """d(state)/dt: the heat balance and, for a hanging muscle, the motion of its mass,

        full:        m d'' + b d' + k_o d = k(T) L_o - F_e - (k(T) - k_o) d
        linearised:  m d'' + b d' + k_o d = C_T T - (F_e - m_bar g)        C_T of the formulas

    Paper, Eqs. TCAMsDynamicEquationOfMotionContraction and ...Linearized, there with F_e = m_bar g.
    """
    heating = heating_rate(tcam, voltage, state.rise)
    if tcam.mounting == "isometric":
        return TCAMState(heating, jnp.zeros_like(state.rise), jnp.zeros_like(state.rise))
    spring = spring_coefficient(tcam, 0.0 if tcam.dynamics == "linearised" else state.rise)
    pull = driving_force(tcam, state.rise) - (hanging_weight(tcam) - coiling_weight(tcam))
    acceleration = (pull - spring * state.contraction - damping_coefficient(tcam) * state.rate) / tcam.mass
    return TCAMState(heating, state.rate, acceleration)


def fastest_rate(tcam: TCAM) -> Scalar:
    """The largest rate [1/s] at which the muscle itself answers at ambient temperature: its heat's lambda / C_t, and
    the larger root, in magnitude, of m s^2 + b s + k_o = 0 if it hangs. An explicit solver must resolve it."""
    cooling = conductance_at(tcam, 0.0) / tcam.thermal_mass
    if tcam.mounting == "isometric":
        return cooling
    half, stiffness = damping_coefficient(tcam) / (2 * tcam.mass), spring_coefficient(tcam, 0.0) / tcam.mass
    overdamped = half + jnp.sqrt(jnp.maximum(half**2 - stiffness, 0.0))
    return jnp.maximum(cooling, jnp.maximum(overdamped, jnp.sqrt(stiffness)))
