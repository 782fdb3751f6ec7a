"""Curves of driven muscles over time: the voltage, the temperature with its peak and its limit, the tension."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from ...physics.tcam import tension_gain
from ...scene import TCAM, ZERO_CELSIUS
from ...scene.quantity import Scalar
from ...solver import Response, tcam_response
from .layout import prefixed
from .panels import case_style, say

if TYPE_CHECKING:
    from ...study import Actuation

_LEAST_OF_AXIS = 0.35  # that temperatures may take of an axis that reaches to a limit; else the limit is a note
_LABEL = 0.12  # of an axis, that a label takes
_SAMPLES, _MOST_SAMPLES, _PER_STEP = 400, 20_000, 8  # of a voltage: at least, at most, and in each of its step limits
# legible where a curve runs through them
_WORDS: dict[str, Any] = {
    "fontsize": 7,
    "verticalalignment": "bottom",
    "path_effects": [withStroke(linewidth=2, foreground="white")],
}
Times = Float[np.ndarray, " times"]
Curve = tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]


def draw_over_time(axes: Axes, actuation: "Actuation", what: str) -> None:
    """Draws "voltage", "temperature" or "tension" of every muscle that a TCAM drives, a line for each.

    The peak temperature is marked where it is, between the instants too. The limit temperature is a dashed line, or a
    note above the axes where it is so far from the temperatures that these could not be read.
    """
    unit, curve_of = _QUANTITIES[what]
    asked = np.asarray(actuation.times)
    curves = {i: curve_of(asked, response, actuation.tcam(i)) for i, response in actuation.responses.items()}
    finite = np.concatenate([values[np.isfinite(values)] for _, values in curves.values()])
    factor, unit = (1.0, unit) if what == "temperature" else prefixed(unit, np.abs(finite).max(initial=0.0))
    clock, seconds = time_unit(actuation)
    for line, (i, (times, values)) in enumerate(curves.items()):
        style: dict[str, Any] = case_style(line) | ({"marker": ""} if len(times) > 1 else {})
        axes.plot(times * clock, values * factor, label=muscle_name(i), gid=what, **style)
    if finite.size == 0:
        say(axes, "no response")
    elif what == "temperature":
        _mark_peaks(axes, actuation)
        _mark_limits(axes, actuation, float(finite.min()), float(finite.max()))
    axes.margins(x=0.03)
    axes.set(xlabel=f"time [{seconds}]", ylabel=f"{what} [{unit}]")


def time_unit(actuation: "Actuation") -> tuple[float, str]:
    """The factor from seconds and the name of the unit in which times are shown; never longer than seconds."""
    return prefixed("s", min(float(actuation.times[-1]), 1.0))


def muscle_name(i: int) -> str:
    """The path of muscle `i`."""
    return f"muscles.{i}"


def peak_words(actuation: "Actuation", i: int) -> str:
    """ "peak 98.17 °C at 5.894 s": the highest temperature of muscle `i`, if it has one."""
    clock, seconds = time_unit(actuation)
    peak = actuation.responses[i].peak
    if not np.isfinite(peak.time):
        return "no response"
    return f"peak {float(peak.temperature) - ZERO_CELSIUS:.4g} °C at {float(peak.time) * clock:.4g} {seconds}"


def limit_words(actuation: "Actuation", i: int) -> str:
    """ "limit 150 °C", of muscle `i`."""
    return f"limit {_limit(actuation, i):.4g} °C"


def _mark_peaks(axes: Axes, actuation: "Actuation") -> None:
    """A ring at every peak, with value and time beside it where there is one muscle alone."""
    clock, _ = time_unit(actuation)
    for line, (i, response) in enumerate(actuation.responses.items()):
        temperature, when = float(response.peak.temperature) - ZERO_CELSIUS, float(response.peak.time) * clock
        if not np.isfinite(temperature):
            continue
        style: dict[str, Any] = case_style(line) | {"markerfacecolor": "white", "linestyle": "", "clip_on": False}
        axes.plot(when, temperature, gid="peak", zorder=3, **style)
        if len(actuation.responses) == 1:
            side = _side(axes, when)
            offset = ({"left": 4, "center": 0, "right": 2}[side], 4)
            words = peak_words(actuation, i)
            look: dict[str, Any] = _WORDS | {"textcoords": "offset points", "gid": "peak"}
            axes.annotate(words, (when, temperature), offset, horizontalalignment=side, **look)


def _side(axes: Axes, when: float) -> str:
    """On which side of an instant words begin so that they stay on the axes."""
    low, high = axes.get_xlim()
    fraction = (when - low) / (high - low)
    return "left" if fraction < 0.35 else "center" if fraction < 0.65 else "right"


def _mark_limits(axes: Axes, actuation: "Actuation", low: float, high: float) -> None:
    """A labelled line at every limit near the temperatures from `low` to `high`, a note for the others."""
    limits: dict[float, list[int]] = {}
    for i in actuation.responses:
        limits.setdefault(_limit(actuation, i), []).append(i)
    notes, last, left = [], -np.inf, not _is_early(axes, actuation)
    for limit, muscles in sorted(limits.items()):
        words = limit_words(actuation, muscles[0])
        if high - low < _LEAST_OF_AXIS * (max(high, limit) - min(low, limit)):
            whose = f"{', '.join(muscle_name(i) for i in muscles)}: " if len(limits) > 1 else ""
            notes.append(f"{whose}{words}, {'above' if limit > high else 'below'} the axis")
            continue
        left ^= limit - last < _LABEL * (max(high, limit) - low)  # beside the last, not on it
        color = "black" if len(limits) == 1 else case_style(list(actuation.responses).index(muscles[0]))["color"]
        axes.axhline(limit, gid="limit", color=color, linewidth=0.8, linestyle=(0, (5, 2)), zorder=1)
        place: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "ha": "left" if left else "right"}
        axes.text(0.03 if left else 0.97, limit, words, color=color, gid="limit", **place, **_WORDS)
        last = limit
    axes.margins(y=0.1)
    if notes:
        axes.set_title("\n".join(notes), fontsize=7)


def _is_early(axes: Axes, actuation: "Actuation") -> bool:
    """Whether the hottest of the muscles is so in the first half of the time: words go where it is not."""
    hottest = max(actuation.responses.values(), key=lambda response: np.nan_to_num(response.peak.temperature))
    return float(hottest.peak.time) * time_unit(actuation)[0] < sum(axes.get_xlim()) / 2


def _limit(actuation: "Actuation", i: int) -> float:
    return float(actuation.tcam(i).limit_temperature) - ZERO_CELSIUS


def _instants(asked: Times, tcam: TCAM) -> Times:
    """The instants asked for, and as many between them as the voltage's fastest changes ask for."""
    assert tcam.voltage is not None, "a driven muscle"
    begin, end = asked[0], asked[-1]
    samples = min(max(_SAMPLES, _PER_STEP * (end - begin) / float(tcam.voltage.step_limit)), _MOST_SAMPLES)
    return np.unique(np.concatenate([asked, np.linspace(begin, end, int(samples))]))


def _voltage(asked: Times, response: Response, tcam: TCAM) -> Curve:
    """The voltage, at jumps with the values before and after."""
    if tcam.voltage is None:
        return asked, np.zeros_like(asked)
    breaks = np.asarray(tcam.voltage.breaks)
    every = np.concatenate([_instants(asked, tcam), breaks, np.nextafter(breaks, -np.inf)])
    times = np.unique(every.clip(asked[0], asked[-1]))
    return times, np.asarray(tcam.voltage(jnp.asarray(times)))


def _temperature(asked: Times, response: Response, tcam: TCAM) -> Curve:
    times, dense = _followed(asked, response, tcam)
    return _with_peak(
        times, np.asarray(dense.temperature) - ZERO_CELSIUS, response, response.peak.temperature - ZERO_CELSIUS
    )


def _tension(asked: Times, response: Response, tcam: TCAM) -> Curve:
    times, dense = _followed(asked, response, tcam)
    highest = tension_gain(tcam) * (response.peak.temperature - tcam.ambient_temperature)
    return _with_peak(times, np.asarray(dense.tension), response, highest)


def _followed(asked: Times, response: Response, tcam: TCAM) -> tuple[Times, Response]:
    """The muscle between the instants too, where these are too sparse to draw a curve through them."""
    if tcam.voltage is None or len(asked) < 2 or not np.isfinite(response.temperature).all():
        return asked, response
    times = _instants(asked, tcam)
    return (asked, response) if len(times) < 2 * len(asked) else (times, tcam_response(tcam, times))


def _with_peak(times: Times, values: Float[np.ndarray, " times"], response: Response, highest: Scalar) -> Curve:
    """The curve through the instants and the peak, which may lie between them."""
    if not np.isfinite(response.peak.time):
        return times, values
    at = np.searchsorted(times, response.peak.time)
    return np.insert(times, at, response.peak.time), np.insert(values, at, highest)


_QUANTITIES: dict[str, tuple[str, Callable[[Times, Response, TCAM], Curve]]] = {
    "voltage": ("V", _voltage),
    "temperature": ("°C", _temperature),
    "tension": ("N", _tension),
}
