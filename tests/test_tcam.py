"""The muscle on its own: formulas beside literal numbers, its motion beside closed forms and SciPy's integrators."""

import dataclasses
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from cosserat_jax import (
    TCAM,
    InputError,
    LinearConductance,
    Pulses,
    ResponseOutcome,
    Sampled,
    Sinusoid,
    Step,
    TCAMState,
    TimeStepping,
    VoltageFunction,
    gain_from_formulas,
    gain_from_measurement,
    tcam_response,
)
from cosserat_jax.physics import tcam as formulas

PAPER = TCAM(voltage=Sinusoid(9.0, 1.0))
RATE = 0.0086 / 0.162  # lambda / C_t [1/s]
POWER = 81.0 / 18.0 / 0.162  # amplitude^2 / (R C_t) [K/s]
QUICK = TimeStepping(diffrax.Tsit5(), rtol=1e-11, atol=1e-11, watch=1)
STIFF = TimeStepping(diffrax.Kvaerno5(), rtol=1e-9, atol=1e-9, watch=1)


def sinusoid_rise(t: np.ndarray) -> np.ndarray:
    """T of C_t T' = A^2 sin^2(t) / R - lambda T from T(0) = 0: sin^2 is (1 - cos 2t) / 2, a constant and a cosine."""
    forced = POWER / 2 * (1 / RATE - (RATE * np.cos(2 * t) + 2 * np.sin(2 * t)) / (RATE**2 + 4))
    return forced - POWER / 2 * (1 / RATE - RATE / (RATE**2 + 4)) * np.exp(-RATE * t)


def heated(times, on, off):
    """T under 9 V between `on` and `off`: saturating, then cooling."""
    warm = POWER / RATE * -np.expm1(-RATE * np.clip(times - on, 0, off - on))
    return warm * np.exp(-RATE * np.clip(times - off, 0, None))


def rise(response) -> np.ndarray:
    return np.asarray(response.temperature) - 296.15


# --- formulas of the coil


def test_fiber_radius():
    assert formulas.fiber_radius(PAPER, 75.0) == pytest.approx(3.681e-4, rel=1e-12)


def test_bending_and_torsional_stiffness():
    assert formulas.bending_stiffness(PAPER, 0.0) == pytest.approx(4.67e8 * 0.25 * math.pi * 3.6e-4**4, rel=1e-12)
    assert formulas.torsional_stiffness(PAPER, 0.0) == pytest.approx(2.2e7 * 0.5 * math.pi * 3.6e-4**4, rel=1e-12)
    assert formulas.bending_stiffness(PAPER, 75.0) / formulas.bending_stiffness(PAPER, 0.0) == pytest.approx(1.0225**4)


def test_coil_angle_and_length_at_ambient_temperature():
    assert formulas.coiled_length(PAPER, 0.0) == pytest.approx(0.2375392, abs=5e-8)
    assert math.degrees(formulas.coil_angle(PAPER, 0.0)) == pytest.approx(math.degrees(math.acos(0.2375392 / 0.46)))


def test_spring_coefficient_holds_the_coiling_mass():
    assert formulas.spring_coefficient(PAPER, 0.0) == pytest.approx(4.3776353, abs=5e-8)
    for t in (-20.0, 0.0, 75.0):
        weight = formulas.spring_coefficient(PAPER, t) * formulas.coiled_length(PAPER, t)
        assert weight == pytest.approx(0.106 * 9.81, rel=1e-14)


def test_damping_is_what_was_given_else_critical():
    assert formulas.damping_coefficient(dataclasses.replace(PAPER, damping=0.3)) == 0.3
    assert formulas.damping_coefficient(PAPER) == pytest.approx(2 * math.sqrt(0.106 * 4.3776353), rel=1e-8)
    assert formulas.damping_from_viscosity(2.0e4, 4.0e-7, 0.25) == pytest.approx(0.032)


def test_tension_gain_from_formulas_and_from_a_measurement():
    assert gain_from_formulas(PAPER, 296.15 + 75) == pytest.approx(8.4506961e-4, rel=1e-8)
    assert formulas.tension_gain(PAPER) == pytest.approx(8.4506961e-4, rel=1e-8)  # the reference is 98 degC
    assert gain_from_measurement(25.0, 98.17 + 273.15, 296.15) == pytest.approx(25 / 75.17, rel=1e-14)


def test_the_coil_angle_as_printed_has_the_wrong_dimension_and_gives_another_length():
    """The paper prints sqrt(B) m_bar g where sqrt(B m_bar g) is meant; the table says 0.418 m, which neither gives."""
    b, c = formulas.bending_stiffness(PAPER, 0.0), formulas.torsional_stiffness(PAPER, 0.0)
    twist = 2 * math.pi * 200 / 0.46
    printed = 0.46 * (1 - (twist * b * c / (math.sqrt(b) * 0.106 * 9.81) - 2 * c) / (b - c))
    assert printed == pytest.approx(0.2436966, abs=5e-8)
    assert abs(printed - formulas.coiled_length(PAPER, 0.0)) > 0.006


# --- heat


@pytest.mark.parametrize("solver", [diffrax.Tsit5(), diffrax.Kvaerno5()], ids=["Tsit5", "Kvaerno5"])
def test_temperature_under_a_sinusoid_is_the_closed_form(solver):
    times = np.linspace(0, 60, 121)
    response = tcam_response(PAPER, times, TimeStepping(solver, watch=1))
    np.testing.assert_allclose(rise(response)[1:], sinusoid_rise(times[1:]), rtol=1e-9)
    np.testing.assert_allclose(response.voltage, 9 * np.sin(times), rtol=0, atol=1e-14)
    assert response.outcome == ResponseOutcome.overheated  # 280 degC, far beyond the limit of 150


def test_first_maximum_is_found_between_the_times_asked_for():
    slope = lambda t: POWER * np.sin(t) ** 2 - RATE * sinusoid_rise(t)  # noqa: E731
    when = brentq(slope, 5.5, 6.2, xtol=1e-13)
    for times in ([6.28], np.linspace(0, 6.28, 50)):
        response = tcam_response(PAPER, times)
        assert response.peak.time == pytest.approx(when, abs=1e-7)
        assert response.peak.temperature == pytest.approx(296.15 + sinusoid_rise(when), abs=1e-7)
    assert response.peak.temperature - 273.15 == pytest.approx(98.1677, abs=1e-4)
    assert response.peak.time == pytest.approx(5.8944, abs=1e-4)
    assert response.outcome == ResponseOutcome.followed


def test_step_and_pulses_are_the_closed_form():
    times = np.linspace(0, 40, 41)
    step = tcam_response(TCAM(voltage=Step(9.0, start=2.5)), times, QUICK)
    np.testing.assert_allclose(rise(step), heated(times, 2.5, np.inf), rtol=1e-9)
    pulses = tcam_response(TCAM(voltage=Pulses(9.0, width=2.0, period=10.0, number=3, start=1.0)), times, QUICK)
    np.testing.assert_allclose(rise(pulses), sum(heated(times, on, on + 2) for on in (1.0, 11.0, 21.0)), rtol=1e-9)
    np.testing.assert_array_equal(pulses.voltage > 0, (times % 10 >= 1) & (times % 10 < 3) & (times < 30))


def test_a_pulse_between_two_instants_is_not_stepped_over():
    response = tcam_response(TCAM(voltage=Pulses(9.0, width=1e-3, period=10.0, number=1, start=5.0)), [20.0], QUICK)
    assert rise(response)[0] == pytest.approx(heated(20.0, 5.0, 5.001), rel=1e-9)
    assert response.peak.time == pytest.approx(5.001)
    assert response.peak.temperature == pytest.approx(296.15 + heated(5.001, 5.0, 5.001), abs=1e-8)


def test_a_sampled_voltage_and_a_function_are_integrated_as_given():
    samples = np.array([0.0, 0.5, 2.0, 2.2, 7.0]), np.array([1.0, 9.0, -3.0, 0.0, 6.0])
    volts = lambda t: np.interp(t, *samples)  # noqa: E731
    exact = [  # variation of constants, piece by piece
        sum(
            quad(lambda u, t=t: volts(u) ** 2 / 18 / 0.162 * math.exp(-RATE * (t - u)), *piece, epsabs=1e-13)[0]
            for piece in zip(np.clip([*samples[0], 9.0], 0, t)[:-1], np.clip([*samples[0], 9.0], 0, t)[1:], strict=True)
        )
        for t in (1.0, 4.0, 9.0)
    ]
    interpolation = diffrax.LinearInterpolation(jnp.asarray([*samples[0], 9.0]), jnp.asarray([*samples[1], 6.0]))
    for voltage in (Sampled(*samples), interpolation, lambda t: jnp.interp(t, *map(jnp.asarray, samples))):
        response = tcam_response(TCAM(voltage=voltage), [1.0, 4.0, 9.0], QUICK)
        np.testing.assert_allclose(rise(response), exact, rtol=1e-8)
        np.testing.assert_allclose(response.voltage, volts(np.array([1.0, 4.0, 9.0])), rtol=1e-14)


def test_short_pulses_of_a_voltage_function_are_seen():
    """Sixty pulses of 9 V, one a second: a geometric series."""
    width = 0.02
    heat, cool, pause = POWER / RATE * -np.expm1(-RATE * width), np.exp(-RATE), np.exp(-RATE * (1 - width))
    voltage = lambda t: 9.0 * jnp.where(jnp.mod(t, 1.0) < width, 1.0, 0.0)  # noqa: E731
    response = tcam_response(TCAM(voltage=voltage, mounting="isometric", limit_temperature=1e5), [0.0, 60.0])
    assert response.outcome == ResponseOutcome.followed
    assert rise(response)[-1] == pytest.approx(heat * pause * (1 - cool**60) / (1 - cool), rel=1e-6)


@pytest.mark.parametrize(
    ("width", "longest", "outcome"), [(1e-4, math.inf, "voltage_not_resolved"), (1e-2, 1e-3, "followed")]
)
def test_pulses_too_short_for_the_samples_say_so_unless_the_longest_step_is_given(width, longest, outcome):
    voltage = VoltageFunction(lambda t: 9.0 * jnp.where(jnp.mod(t, 0.1) < width, 1.0, 0.0), longest)
    response = tcam_response(TCAM(voltage=voltage, mounting="isometric"), [5.0], dataclasses.replace(QUICK, watch=10))
    assert response.outcome == getattr(ResponseOutcome, outcome)
    assert np.isfinite(response.temperature).all() == (outcome == "followed")


@pytest.mark.parametrize("law", [LinearConductance(2e-5), lambda rise: 2e-5 * rise], ids=["linear", "function"])
def test_conductance_may_change_with_temperature(law):
    response = tcam_response(TCAM(voltage=Step(9.0), conductance_law=law), [5.0, 50.0], QUICK)
    slope = lambda _, T: (81 / 18 - (0.0086 + 2e-5 * T) * T) / 0.162  # noqa: E731
    exact = solve_ivp(slope, (0, 50), [0.0], t_eval=[5.0, 50.0], method="DOP853", rtol=1e-12, atol=1e-12).y[0]
    np.testing.assert_allclose(rise(response), exact, rtol=1e-9)


def test_no_voltage_leaves_the_muscle_as_it_is():
    response = tcam_response(TCAM(), [0.0, 3.0], QUICK)
    np.testing.assert_array_equal(rise(response), 0)
    np.testing.assert_array_equal(response.contraction, 0)
    assert response.peak.time == 0


# --- motion


def by_scipy(tcam: TCAM, times: np.ndarray, start: tuple[float, float, float]) -> np.ndarray:
    """(T, d, d') by SciPy from the equations of motion as the paper writes them, for 9 sin(t) V."""
    weight, k = tcam.coiling_mass * tcam.gravity, lambda T: float(formulas.spring_coefficient(tcam, T))
    k_o, b = k(0.0), float(formulas.damping_coefficient(tcam))
    force = weight if tcam.hanging_mass is None else tcam.hanging_mass * tcam.gravity
    length, gain = weight / k_o, 8.4506961401e-4

    def slope(t, y):
        T, d, w = y
        full, linearised = k(T) * length - force - (k(T) - k_o) * d, gain * T + weight - force
        drive = full if tcam.dynamics == "full" else linearised
        return POWER * math.sin(t) ** 2 - RATE * T, w, (drive - b * w - k_o * d) / tcam.mass

    return solve_ivp(slope, (0, times[-1]), start, t_eval=times, method="DOP853", rtol=1e-11, atol=1e-13).y


@pytest.mark.parametrize("dynamics", ["linearised", "full"])
def test_motion_under_a_hanging_mass_is_scipy_s(dynamics):
    times = np.linspace(0, 8, 9)
    tcam = dataclasses.replace(PAPER, dynamics=dynamics, damping=0.2, hanging_mass=0.15)
    stretched = -(0.15 - 0.106) * 9.81 / 4.377635341276483  # the extra mass pulls it out before the voltage starts
    response = tcam_response(tcam, times, QUICK)
    exact = by_scipy(tcam, times, (0.0, stretched, 0.0))
    np.testing.assert_allclose(response.contraction, exact[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(response.contraction_rate, exact[2], rtol=0, atol=1e-9)
    assert response.contraction[0] == pytest.approx(stretched)


@pytest.mark.parametrize("dynamics", ["linearised", "full"])
def test_held_isometrically_it_pulls_and_does_not_move(dynamics):
    tcam = dataclasses.replace(PAPER, dynamics=dynamics, mounting="isometric")
    response = tcam_response(tcam, [3.0, 5.8944], QUICK)
    T = sinusoid_rise(np.array([3.0, 5.8944]))
    k = np.array([float(formulas.spring_coefficient(tcam, t)) for t in T])
    force = 8.4506961e-4 * T if dynamics == "linearised" else (k - 4.377635341276483) * 0.23753920071761508
    np.testing.assert_allclose(response.force, force, rtol=1e-7)
    np.testing.assert_array_equal(response.contraction, 0)


@pytest.mark.parametrize("dynamics", ["linearised", "full"])
def test_long_after_a_step_it_rests_where_statics_say(dynamics):
    tcam = TCAM(voltage=Step(5.0), dynamics=dynamics, hanging_mass=0.12)
    response = tcam_response(tcam, [900.0], STIFF)
    T = 25 / 18 / 0.0086
    assert rise(response)[0] == pytest.approx(T, rel=1e-8)
    if dynamics == "full":  # k(T) (L_o - d) = F_e
        contraction = 0.23753920071761508 - 0.12 * 9.81 / formulas.spring_coefficient(tcam, T)
    else:  # k_o d = C_T T - (F_e - m_bar g)
        contraction = (8.4506961401e-4 * T - 0.014 * 9.81) / 4.377635341276483
    assert float(response.contraction[0]) == pytest.approx(float(contraction), rel=1e-7)


def test_linearised_and_full_dynamics_agree_to_first_order_in_the_temperature():
    """With C_T the slope at T = 0 the two differ by T^2; with the paper's C_T, a secant up to 98 degC, by T."""
    tight = dataclasses.replace(QUICK, atol=1e-14)

    def order(reference_temperature: float) -> float:
        differences, temperatures = [], []
        for amplitude in (1.0, 0.25):
            tcam = TCAM(voltage=Sinusoid(amplitude, 1.0), reference_temperature=reference_temperature)
            linearised = tcam_response(tcam, [5.0], tight)
            full = tcam_response(dataclasses.replace(tcam, dynamics="full"), [5.0], tight)
            differences.append(abs(float(linearised.contraction[0] - full.contraction[0])))
            temperatures.append(rise(linearised)[0])
        return math.log(differences[0] / differences[1]) / math.log(temperatures[0] / temperatures[1])

    assert order(296.15 + 1e-4) == pytest.approx(2, abs=0.02)
    assert order(296.15 + 75) == pytest.approx(1, abs=0.05)


def test_a_measured_tension_gain_changes_the_pull_on_the_arm_and_not_the_muscle_s_own_motion():
    """With the paper's 25 N at 98 degC the linearised equation would contract a fiber of 0.46 m by 5.7 m."""
    measured = dataclasses.replace(PAPER, tension_gain=25 / 75.17)
    alone, strong = (tcam_response(tcam, [5.8944], QUICK) for tcam in (PAPER, measured))
    np.testing.assert_allclose(strong.contraction, alone.contraction, rtol=1e-12)
    np.testing.assert_allclose(alone.tension, 8.4506961e-4 * sinusoid_rise(5.8944), rtol=1e-8)
    np.testing.assert_allclose(strong.tension, 25 / 75.17 * sinusoid_rise(5.8944), rtol=1e-8)


def test_energy_decays_without_voltage():
    tcam = TCAM(damping=0.1)
    start = TCAMState(rise=0.0, contraction=0.02, rate=0.0)
    response = tcam_response(tcam, np.linspace(0, 5, 101), QUICK, start)
    energy = 0.5 * 0.106 * response.contraction_rate**2 + 0.5 * 4.377635341276483 * response.contraction**2
    assert (np.diff(energy) < 0).all()
    frequency = math.sqrt(4.377635341276483 / 0.106 - (0.1 / 0.212) ** 2)
    phase = frequency * np.linspace(0, 5, 101)
    decay = np.exp(-0.1 / 0.212 * np.linspace(0, 5, 101))
    exact = 0.02 * decay * (np.cos(phase) + 0.1 / 0.212 / frequency * np.sin(phase))
    np.testing.assert_allclose(response.contraction, exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize("constants", [{"damping": 1.36e8}, {"mass": 1e-9}, {"damping": 1.36, "mass": 1e-9}])
def test_stiff_muscles_follow_their_slow_motion(constants):
    """Ratios of rates from 1e4 to 1e16: the fast mode dies at once and b d' + k_o d = C_T T is left."""
    tcam = dataclasses.replace(PAPER, **constants)
    times = np.linspace(0, 10, 6)
    response = tcam_response(tcam, times, STIFF)
    pull, rate = 8.4506961401e-4 / 4.377635341276483, 4.377635341276483 / float(formulas.damping_coefficient(tcam))
    slow = lambda t, d: rate * (pull * sinusoid_rise(t) - d)  # noqa: E731
    exact = solve_ivp(slow, (0, 10), [0.0], t_eval=times, method="Radau", rtol=1e-10, atol=1e-16).y[0]
    np.testing.assert_allclose(response.contraction, exact, rtol=0, atol=max(2e-6 * exact.max(), 1e-14))
    assert isinstance(TimeStepping.suited_to(tcam).solver, diffrax.Kvaerno5)
    assert response.steps < 2000


def test_the_default_solver_is_explicit_where_the_muscle_is_slow():
    assert isinstance(TimeStepping.suited_to(PAPER).solver, diffrax.Tsit5)
    assert isinstance(TimeStepping.suited_to(dataclasses.replace(PAPER, conductance=200.0)).solver, diffrax.Kvaerno5)
    held = dataclasses.replace(PAPER, mass=1e-9, mounting="isometric")
    assert isinstance(TimeStepping.suited_to(held).solver, diffrax.Tsit5)


# --- outcomes


def test_each_muscle_of_a_batch_has_its_own_outcome():
    def of(amplitude, fiber_length):
        tcam = TCAM(voltage=Sinusoid(amplitude, 1.0), fiber_length=fiber_length)
        return tcam_response(tcam, jnp.asarray([3.0, 6.0]), QUICK)

    batch = jax.vmap(of)(jnp.asarray([9.0, 30.0, 9.0]), jnp.asarray([0.46, 0.46, 0.1]))
    alone = tcam_response(PAPER, [3.0, 6.0], QUICK)
    expected = [ResponseOutcome.followed, ResponseOutcome.overheated, ResponseOutcome.no_coil]
    for i, outcome in enumerate(expected):
        assert jax.tree.map(lambda leaf, i=i: leaf[i], batch.outcome) == outcome
    np.testing.assert_allclose(batch.temperature[0], alone.temperature, rtol=1e-13)
    np.testing.assert_allclose(rise(batch)[1], sinusoid_rise(np.array([3.0, 6.0])) * (30 / 9) ** 2, rtol=1e-9)
    assert np.isnan(batch.temperature[2]).all()
    assert batch.steps[2] == 0  # what makes no coil is not integrated


def test_an_integration_that_does_not_finish_says_so_and_is_not_tried_again_in_later_intervals():
    method = dataclasses.replace(QUICK, max_steps=16, watch=50)
    response = tcam_response(dataclasses.replace(PAPER, damping=1e5), [10.0], method)
    assert response.steps == 16
    assert response.outcome == ResponseOutcome.integration_failed
    assert np.isnan(response.temperature).all()
    assert np.isnan(response.contraction).all()


@pytest.mark.parametrize(
    ("tcam", "times", "said"),
    [
        ({"resistance": 0.0}, [1.0], "tcam.resistance must be positive, but is 0 ohm"),
        ({"conductance": math.nan}, [1.0], "tcam.conductance must be at least 0, but is nan"),
        ({"limit_temperature": 290.0}, [1.0], "the ambient temperature"),
        ({"dynamics": "linear"}, [1.0], "'linearised' or 'full'"),
        ({"voltage": 9.0}, [1.0], "tcam.voltage must be a voltage or a function of time, but is 9.0"),
        (
            {"voltage": Pulses(9.0, width=2.0, period=1.0, number=2)},
            [1.0],
            "voltage.width must be at most 1 s, the period, but is 2",
        ),
        (
            {"voltage": Pulses(9.0, width=1.0, period=2.0, number=0)},
            [1.0],
            "voltage.number must be a whole number from 1 to 100000, but is 0",
        ),
        ({"voltage": Sampled([0.0, 1.0, 1.0], [0.0, 1.0, 2.0])}, [1.0], "must ascend"),
        ({"voltage": Sampled([0.0, 1.0], [0.0])}, [1.0], "as many times as values"),
        ({"voltage": Sinusoid(9.0, -1.0)}, [1.0], "voltage.frequency must be at least 0"),
        (
            {"voltage": Sampled([100.0, 101.0], [6.0, 0.0])},
            [101.0],
            "must start at 0 s, .* but start at 100 s with 6 V",
        ),
        ({}, [], "not empty"),
        ({}, [2.0, 1.0], "ascending"),
        ({}, [-1.0, 1.0], "from 0 on"),
        ({}, [1.0, math.inf], "finite"),
    ],
)
def test_constants_and_times_that_are_not_allowed_are_named(tcam, times, said):
    with pytest.raises(InputError, match=said.replace("'", ".")):
        tcam_response(TCAM(**tcam), times)


# --- derivatives


def contraction_and_temperature(tcam: TCAM) -> jax.Array:
    response = tcam_response(tcam, jnp.asarray([4.0, 9.0]), dataclasses.replace(QUICK, rtol=1e-12, atol=1e-12))
    return jnp.concatenate([response.contraction * 1e3, response.temperature])


def test_derivatives_by_every_float_are_those_of_differences_in_both_modes():
    tcam = TCAM(
        voltage=Pulses(9.0, width=1.5, period=3.0, number=2, start=0.5),
        conductance_law=LinearConductance(1e-5),
        damping=0.4,
        hanging_mass=0.11,
        dynamics="full",
    )
    leaves, tree = jax.tree.flatten(tcam)
    vector = jnp.asarray(leaves, float)
    of = lambda v: contraction_and_temperature(jax.tree.unflatten(tree, list(v)))  # noqa: E731
    forward, backward = jax.jit(jax.jacfwd(of))(vector), jax.jit(jax.jacrev(of))(vector)
    np.testing.assert_allclose(backward, forward, rtol=1e-9, atol=1e-12 * np.abs(forward).max())
    step = 1e-5 * np.maximum(np.abs(vector), 1e-6)
    plus, minus = (jax.jit(jax.vmap(of))(vector[None] + sign * np.diag(step)) for sign in (1, -1))
    difference = ((plus - minus) / (2 * step[:, None])).T
    for column, wanted in zip(np.asarray(forward).T, np.asarray(difference).T, strict=True):
        np.testing.assert_allclose(column, wanted, rtol=0, atol=1e-6 * np.abs(wanted).max() + 1e-9)


def test_derivatives_pass_through_a_voltage_function_and_a_law_that_close_over_a_number():
    def warm(amplitude, slope):
        tcam = TCAM(voltage=lambda t: amplitude * jnp.sin(t), conductance_law=lambda rise: slope * rise)
        return tcam_response(tcam, [4.0], QUICK).temperature[0]

    def by_parts(amplitude, slope):
        tcam = TCAM(voltage=Sinusoid(amplitude, 1.0), conductance_law=LinearConductance(slope))
        return tcam_response(tcam, [4.0], QUICK).temperature[0]

    closed = jax.jit(jax.grad(warm, argnums=(0, 1)))(9.0, 1e-5)
    np.testing.assert_allclose(closed, jax.jit(jax.jacfwd(by_parts, argnums=(0, 1)))(9.0, 1e-5), rtol=1e-9)


@jax.jit
def _pulsed(of: jax.Array, times: jax.Array) -> jax.Array:
    """Temperatures and the peak, under two pulses of this start, width and period."""
    voltage = Pulses(9.0, width=of[1], period=of[2], number=2, start=of[0])
    tcam = TCAM(voltage=voltage, mounting="isometric", limit_temperature=1e5)
    response = tcam_response(tcam, times, dataclasses.replace(QUICK, watch=12))
    return jnp.append(response.temperature, response.peak.temperature)


_by_pulses = jax.jit(jax.jacfwd(_pulsed)), jax.jit(jax.jacrev(_pulsed))


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.integers(0, 3), st.integers(1, 4), st.integers(0, 2), st.lists(st.integers(0, 12), min_size=3, max_size=3))
def test_derivatives_by_the_instants_of_jumps_hold_where_jumps_fall_on_instants_and_on_each_other(
    start, width, pause, times
):
    """A jump moves the temperature after it at (v_before^2 - v_after^2) / (R C_t) exp(-lambda (t - jump) / C_t)."""
    period, times = float(width + pause), np.array([*sorted(times), 12.0])
    off = np.array([start + width, start + period + width])
    on = off - width
    after = lambda jumps, t: POWER * np.where(jumps < t, np.exp(-RATE * (t - jumps)), 0.0)  # noqa: E731
    rows = [
        (after(off, t).sum() - after(on, t).sum(), after(off, t).sum(), (after(off, t) - after(on, t))[1])
        for t in times
    ]
    top = np.nextafter(off[-1], 13)  # the peak is where the last pulse ends
    rows.append(
        (
            POWER + after(off[:1], top)[0] - after(on, top).sum() - RATE * _at(on, off, off[-1]),
            after(off[:1], top)[0] + POWER - RATE * _at(on, off, off[-1]),
            POWER - after(on, top)[1] - RATE * _at(on, off, off[-1]),
        )
    )
    arguments = jnp.array([start, width, period], float), jnp.asarray(times)
    for by in _by_pulses:
        np.testing.assert_allclose(by(*arguments), rows, rtol=0, atol=1e-6)


def _at(on: np.ndarray, off: np.ndarray, t: float) -> float:
    return sum(heated(t, *pulse) for pulse in zip(on, off, strict=True))


@pytest.mark.parametrize("mounting", ["hanging", "isometric"])
def test_two_moduli_at_which_the_formula_divides_by_zero_make_no_coil(mounting):
    """B = C where axial_modulus = 2 shear_modulus."""
    tcam = TCAM(axial_modulus=2e9, shear_modulus=1e9, voltage=Step(9.0), mounting=mounting)
    response = tcam_response(tcam, [4.0], QUICK)
    assert ResponseOutcome[response.outcome] == ResponseOutcome[ResponseOutcome.no_coil]


def test_a_sinusoid_of_no_frequency_has_the_derivatives_of_a_slow_one():
    def warm(amplitude, frequency, phase):
        tcam = TCAM(voltage=Sinusoid(amplitude, frequency, phase), mounting="isometric")
        return tcam_response(tcam, [2.0, 2.0, 4.0], QUICK).temperature[-1]

    by = jax.jit(jax.grad(warm, argnums=(0, 1, 2)))
    np.testing.assert_allclose(by(9.0, 0.0, 0.3), by(9.0, 1e-9, 0.3), rtol=1e-7)
    np.testing.assert_allclose(by(0.0, 0.0, 0.3), 0.0, atol=1e-12)


def test_a_step_at_zero_has_the_derivative_of_one_that_starts_later():
    of = lambda start: tcam_response(TCAM(voltage=Step(9.0, start)), [4.0], QUICK).temperature[0]  # noqa: E731
    assert jax.grad(of)(0.0) == pytest.approx(-POWER * np.exp(-RATE * 4), rel=1e-8)


def test_derivatives_by_the_times_of_samples_hold_where_they_are_asked_for():
    def of(times, asked):
        tcam = TCAM(voltage=Sampled(times, jnp.array([0.0, 9.0, 3.0, 6.0])), mounting="isometric")
        return tcam_response(tcam, asked, QUICK).temperature[-1]

    times = jnp.array([0.0, 1.0, 2.0, 4.0])
    apart, together = (jax.grad(of)(times, jnp.array(asked)) for asked in ([1.5, 1.7, 5.0], [1.0, 2.0, 5.0]))
    np.testing.assert_allclose(together[1:], apart[1:], rtol=1e-7)
