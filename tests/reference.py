"""Reference solution of the planar extended Cosserat arm by SciPy collocation, apart from the package.

Model: Golestaneh, Cichella & Lamuta, "Quasi-Static Continuum Model of Octopus-Like Soft Robot Arm Under Water
Actuated by TCAMs". Kept here are the *internal* force and the paper's local balance equations, where a muscle
is a force spread over its path and a concentrated one at its end. SI units; prime is d/ds; components in the
directors (a, b), k = a x b; X = ventral R(s); y(s) is the signed offset of a muscle.

    states    x, y, theta, n_a, n_b, mu, beta   on every piece of rod between two muscle ends
    strains   nu = 1 + n_a / EA,  eta = n_b / GA,  EA = c E pi (beta R)^2,  EJ = c E pi (beta R)^4 / 4
    pose      x' = nu cos - eta sin,  y' = nu sin + eta cos,  theta' = mu = m / EJ
    muscle    t = p a + w b,  p = nu - y beta mu,  w = eta + (y beta)';  d = t ("unnormalized") or t / |t| ("unit")
    forces    n_a' - mu n_b + sum T (d_a' - mu d_b) + f_a = 0
              n_b' + mu n_a + sum T (d_b' + mu d_a) + f_b = 0
    moment    m' + nu n_b - eta n_a - sum T y beta (d_a' - mu d_b) + m_water = 0
    section   beta' (nu - 2 beta X mu) + beta (nu' - beta X' mu - beta X mu') = 0,  or beta = 1 if rigid;
              beta (nu - beta X mu) = 1 at the start of each piece

At given states these are four linear equations for (n_a', n_b', mu', beta'), but for two places where beta'
enters nonlinearly or is differentiated: w, and the slope of the wetted surface. There P(s) = beta'(s) of the
previous pass stands in, and passes are repeated until P reproduces itself (each gains one or two digits): at
the end beta' is the exact total derivative. A unit tangent on a volume-preserving section makes beta(s) obey
an implicit ODE with a tiny factor before beta'; the passes give its smooth solution.

At the end of a muscle n changes by its pull -T d and m by the moment of that. Since beta jumps too, so does d
of the muscles running on: continuous are n + sum T d and m - sum T y beta d_a. The tip is loaded likewise.
All pieces are stacked on [0, 1] in one `solve_bvp`. The equilibrium is the one reached from the unloaded arm
as tensions, weight, water force and tip load grow together, lambda = 0..1: steps are cut until the shape
changes little and as predicted, so that no branch is jumped.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
Scene = dict[str, Any]
Slope = Callable[[Array], tuple[Array, Array]]  # points of [0, 1] -> P, P' of shape (pieces, points)
NAMES = ("x", "y", "theta", "n_a", "n_b", "mu", "beta")


class Rod:
    """Equations of one scene. Arrays are ([muscles,] pieces, points); `load_scene` is lambda, `bulge` P."""

    def __init__(self, scene: Scene) -> None:
        arm, tip, muscles = scene["arm"], scene.get("tip", {}), scene.get("muscles", [])
        self.length, self.base_radius = arm["length"], arm["base_radius"]
        self.radius_slope = (arm["tip_radius"] - self.base_radius) / self.length
        self.ventral, self.base_angle = arm.get("ventral", 1), arm.get("base_angle", 0.0)
        self.constants: dict[str, float] | None = arm.get("stiffness")
        self.rigid = self.constants is not None or arm.get("cross_section") == "rigid"
        if self.constants is None:
            self.youngs = arm.get("stiffness_factor", 1.0) * arm["youngs_modulus"]
            self.shear_modulus = self.youngs / (2 * (1 + arm["poisson_ratio"]))
        self.water: dict[str, float] | None = scene.get("water")
        excess_density = arm.get("density", 0.0) - (self.water["density"] if self.water else 0.0)
        self.specific_weight = scene.get("gravity", {}).get("acceleration", 0.0) * excess_density
        self.tip_force = np.array(tip.get("force", (0.0, 0.0)), dtype=float)
        self.tip_moment, self.follower = tip.get("moment", 0.0), tip.get("follower", False)

        def column(values: list[float]) -> Array:
            return np.array(values, dtype=float).reshape(-1, 1, 1)

        end = column([m.get("end", self.length) for m in muscles])
        self.offset_base = column([m["side"] * m["base_offset"] for m in muscles])
        self.offset_slope = column([m["side"] * (m["end_offset"] - m["base_offset"]) for m in muscles]) / end
        self.unit = column([m.get("tangent", "unnormalized") == "unit" for m in muscles]) > 0
        ends = np.unique(np.append(end, self.length))
        self.start = np.append(0.0, ends[:-1])[:, None]
        self.span = ends[:, None] - self.start
        self.pieces = len(ends)
        self.reaches = end >= ends[:, None]
        # Zero on the pieces beyond the end of a muscle.
        self.tension = column([m["tension"] for m in muscles]) * self.reaches
        bending = self.bending(np.array([self.length / 2]), np.ones(1))[0]
        self.force = bending / self.length**2 + self.tension.sum(axis=0).max() + np.abs(self.tip_force).max()
        size = [self.length, self.length, 1.0, self.force, self.force, 1 / self.length, 1.0]
        self.scale = np.array(size)[:, None]

    def radius(self, s: Array) -> Array:
        return self.base_radius + self.radius_slope * s

    def bending(self, s: Array, beta: Array) -> Array:
        if self.constants:
            return np.full_like(s, self.constants["bending"])
        return self.youngs * np.pi * (beta * self.radius(s)) ** 4 / 4

    def section(self, s: Array, state: Array, bulge: Array) -> SimpleNamespace:
        """Strains, stiffnesses and muscle directions at states (7, pieces, points)."""
        _, _, _, n_a, n_b, mu, beta = state
        if self.constants:
            axial, shear = self.constants["axial"], self.constants["shear"]
        else:
            area = np.pi * (beta * self.radius(s)) ** 2
            axial, shear = self.youngs * area, self.shear_modulus * area
        nu, eta = 1 + n_a / axial, n_b / shear
        offset = self.offset_base + self.offset_slope * s
        p, w = nu - offset * beta * mu, eta + self.offset_slope * beta + offset * bulge
        stretch = np.where(self.unit, np.hypot(p, w), 1.0)
        return SimpleNamespace(
            axial=axial, shear=shear, bending=self.bending(s, beta), nu=nu, eta=eta, offset=offset,
            side=self.ventral * self.radius(s), stretch=stretch, d_a=p / stretch, d_b=w / stretch,
        )  # fmt: skip

    def total(self, s: Array, state: Array, load: float, bulge: Array) -> Array:
        """Internal load plus the pull of the muscles (a, b, moment): what no muscle end interrupts."""
        k = self.section(s, state, bulge)
        pull_a, pull_b = load * self.tension * k.d_a, load * self.tension * k.d_b
        moment = k.bending * state[5] - (k.offset * state[6] * pull_a).sum(axis=0)
        return np.stack([state[3] + pull_a.sum(axis=0), state[4] + pull_b.sum(axis=0), moment])

    def external(self, s: Array, state: Array, k: SimpleNamespace, bulge: Array) -> list[Array]:
        """Weight and water per length of centerline: force (a, b) and moment about the centerline."""
        _, height, theta, _, _, mu, beta = state
        cos, sin, girth = np.cos(theta), np.sin(theta), 2 * np.pi * beta * self.radius(s)
        weight = self.specific_weight * girth**2 / (4 * np.pi) * k.nu
        if (water := self.water) is None:
            return [-weight * sin, -weight * cos, np.zeros_like(s)]
        along = k.nu - k.side * beta * mu
        across = k.eta + self.ventral * self.radius_slope * beta + k.side * bulge
        t_a, t_b = along / np.hypot(along, across), across / np.hypot(along, across)
        u_a, u_b = -self.ventral * t_b, self.ventral * t_a
        speed = water["velocity"] + water.get("velocity_gradient", 0.0) * height
        v_t, v_n = speed * (t_a * cos - t_b * sin), speed * (u_a * cos - u_b * sin)
        flux = water["density"] * girth / 2
        normal = flux * np.abs(v_n) * v_n
        tangential = flux * (v_n**2 + 2 * water.get("inlet_fraction", 1.0) * v_t * v_n)
        tangential = tangential - girth * water["viscosity"] * v_t / water["boundary_layer"]
        drag_a, drag_b = normal * u_a + tangential * t_a, normal * u_b + tangential * t_b
        return [drag_a - weight * sin, drag_b - weight * cos, -k.side * beta * drag_a]

    def system(self, s: Array, state: Array, load: float, bulge: Array, bulge_s: Array) -> list[Array]:
        """Matrix (pieces, points, 4, 4) and right side of the equations for (n_a', n_b', mu', beta')."""
        _, _, _, n_a, n_b, mu, beta = state
        k = self.section(s, state, bulge)
        f_a, f_b, m_water = (load * part for part in self.external(s, state, k, bulge))
        # A new axis for the probes below.
        of_muscles = (self.tension, self.unit, self.offset_slope, k.offset, k.d_a, k.d_b, k.stretch)
        tension, unit, offset_slope, offset, d_a, d_b, stretch = (part[:, None] for part in of_muscles)
        taper = 0.0 if self.constants else self.radius_slope / self.radius(s)

        def imbalance(rates: Array) -> Array:
            n_a_s, n_b_s, mu_s, beta_s = rates
            growth = beta_s / beta + taper
            nu_s = n_a_s / k.axial - 2 * (k.nu - 1) * growth
            eta_s = n_b_s / k.shear - 2 * k.eta * growth
            m_s = k.bending * (mu_s + 4 * mu * growth)
            p_s = nu_s - (offset_slope * beta + offset * beta_s) * mu - offset * beta * mu_s
            w_s = eta_s + offset_slope * (beta_s + bulge) + offset * bulge_s
            lengthening = np.where(unit, d_a * p_s + d_b * w_s, 0.0)
            pull_a = load * tension * ((p_s - lengthening * d_a) / stretch - mu * d_b)
            pull_b = load * tension * ((w_s - lengthening * d_b) / stretch + mu * d_a)
            balance_a = n_a_s - mu * n_b + pull_a.sum(axis=0) + f_a
            balance_b = n_b_s + mu * n_a + pull_b.sum(axis=0) + f_b
            balance_m = m_s + k.nu * n_b - k.eta * n_a - (offset * beta * pull_a).sum(axis=0) + m_water
            volume = beta_s * (k.nu - 2 * beta * k.side * mu)
            volume = volume + beta * (nu_s - beta * (self.ventral * self.radius_slope * mu + k.side * mu_s))
            return np.stack([balance_a, balance_b, balance_m, beta_s if self.rigid else volume])

        # Affine in the four rates: its values at 0 and at the unit vectors give the linear system.
        probes = np.eye(4, 5, 1)[:, :, None, None] * np.ones_like(s)
        sample = np.moveaxis(imbalance(probes), (0, 1), (-2, -1))
        return [sample[..., 1:] - sample[..., :1], -sample[..., :1]]

    def rates(self, s: Array, state: Array, load: float, bulge: Array, bulge_s: Array) -> Array:
        """State derivatives (7, pieces, points)."""
        solved = np.linalg.solve(*self.system(s, state, load, bulge, bulge_s))
        k, cos, sin = self.section(s, state, bulge), np.cos(state[2]), np.sin(state[2])
        pose = np.stack([k.nu * cos - k.eta * sin, k.nu * sin + k.eta * cos, state[5]])
        return np.concatenate([pose, np.moveaxis(solved[..., 0], -1, 0)])

    def unpack(self, y: Array) -> Array:
        """Scaled unknowns of the solver (7 pieces, points) -> states in SI units (7, pieces, points)."""
        return np.moveaxis(y.reshape(self.pieces, len(NAMES), -1) * self.scale, 0, 1)

    def pack(self, state: Array) -> Array:
        return (np.moveaxis(state, 1, 0) / self.scale).reshape(self.pieces * len(NAMES), -1)

    def rhs(self, xi: Array, y: Array, load: float, slope: Slope) -> Array:
        s = self.start + self.span * xi
        return self.pack(self.span * self.rates(s, self.unpack(y), load, *slope(xi)))

    def boundary(self, y_start: Array, y_end: Array, load: float, slope: Slope) -> Array:
        """Clamp, continuity of pose and total load between pieces, the volume where each starts, the tip."""
        start, end = self.unpack(y_start[:, None]), self.unpack(y_end[:, None])
        bulge = slope(np.array([0.0, 1.0]))[0]
        total_start = self.total(self.start, start, load, bulge[:, :1])[..., 0]
        total_end = self.total(self.start + self.span, end, load, bulge[:, 1:])[..., 0]
        (f_a, f_b), cos, sin = self.tip_force, np.cos(end[2, -1, 0]), np.sin(end[2, -1, 0])
        if not self.follower:
            f_a, f_b = f_a * cos + f_b * sin, f_b * cos - f_a * sin
        beyond = np.column_stack([total_start[:, 1:], load * np.array([f_a, f_b, self.tip_moment])])
        before = np.column_stack([[0.0, 0.0, self.base_angle], end[:3, :-1, 0]])
        k = self.section(self.start, start, bulge[:, :1])
        volume = start[6] - 1 if self.rigid else start[6] * (k.nu - start[6] * k.side * start[5]) - 1
        pose = (start[:3, :, 0] - before) / self.scale[:3]
        loads = (beyond - total_end) / (self.force * np.array([[1.0], [1.0], [self.length]]))
        return np.concatenate([pose.ravel(), loads.ravel(), volume.ravel()])


class Equilibrium(NamedTuple):
    """One collocation solution; `slope` is the P it was computed with, `next_slope` the one it gives."""

    load: float
    xi: Array  # mesh
    curve: Callable[[Array], Array]
    margin: float  # derivative of the volume constraint by beta at fixed load: 1 at rest, 0 where beta folds
    slope: Slope
    next_slope: Slope


def collocate(
    rod: Rod, load: float, xi: Array, y: Array, slope: Slope, tol: float = 1e-4, max_nodes: int = 1500
) -> Equilibrium | None:
    """The equilibrium near the guess y(xi), or None if there is none or its volume constraint has folded."""
    try:
        with np.errstate(all="ignore"):
            found = solve_bvp(
                lambda x, u: rod.rhs(x, u, load, slope),
                lambda start, end: rod.boundary(start, end, load, slope),
                xi, y, tol=tol, bc_tol=tol, max_nodes=max_nodes,
            )  # fmt: skip
    except np.linalg.LinAlgError:  # the iterates went astray
        return None
    at = (rod.start + rod.span * found.x, rod.unpack(found.y), load, *slope(found.x))
    matrix, _ = rod.system(*at)
    margin = float(np.min(np.linalg.det(matrix) / np.linalg.det(matrix[..., :3, :3])))
    if found.status != 0 or not margin > 0 or not np.all(at[1][6] > 0):
        return None
    rate = CubicSpline(found.x, rod.rates(*at)[6], axis=1)
    return Equilibrium(load, found.x, found.sol, margin, slope, lambda x: (rate(x), rate(x, 1) / rod.span))


def straight(rod: Rod, load: float) -> Equilibrium | None:
    """The equilibrium that collocation finds from the unloaded straight arm."""
    xi = np.linspace(0, 1, 16)
    s, angle = rod.start + rod.span * xi, np.full((rod.pieces, 16), rod.base_angle)
    rest = np.stack([s * np.cos(angle), s * np.sin(angle), angle, 0 * s, 0 * s, 0 * s, 0 * s + 1])
    return collocate(rod, load, xi, rod.pack(rest), lambda x: (np.zeros((rod.pieces, len(x))),) * 2)


def march(rod: Rod, max_change: float, min_step: float) -> Equilibrium:
    """Raise the load from 0 towards 1; the last equilibrium of the branch."""
    here = straight(rod, 0.0)
    before, step = here, 0.1

    def shape_change(y: Array, other: Array) -> float:
        return np.abs((y - other).reshape(rod.pieces, len(NAMES), -1)[:, [0, 1, 2, 6]]).max()

    while here.load < 1 and step > min_step:
        load = min(1.0, here.load + step)
        xi = np.union1d(here.xi[:: max(1, len(here.xi) // 40)], 1.0)  # thinned, else refinement piles up
        now = here.curve(xi)
        guess = now + (now - before.curve(xi)) * (load - here.load) / max(here.load - before.load, min_step)
        there = collocate(rod, load, xi, guess, here.next_slope)
        change = shape_change(there.curve(xi), now) if there else np.inf
        surprise = shape_change(there.curve(xi), guess) if there and here.load > 0 else 0.0
        if change < max_change and surprise < max_change / 3:
            before, here = here, there
            step *= np.clip(0.6 * max_change / max(change, 1.5 * surprise, 1e-9), 0.5, 2.0)
        else:
            step /= 2
    return here


def solve(
    scene: Scene, tol: float = 1e-9, cold: bool = False, max_change: float = 0.3, min_step: float = 1e-5
) -> SimpleNamespace:
    """Equilibrium of `scene`; if there is none, `converged` is False and the rest is where loading stopped.

    Gives `converged`, `message`, `load_fraction`; at the tip `x, y, theta, nu, eta, mu, beta`; `fields(s)`:
    these at any s, the internal `n_a, n_b, m`, and `Fx, Fy, M`, which hold the pull of the muscles too; at a
    muscle end those of the piece before it; `displacements`: how much shorter than at rest the path of each muscle
    is. `tol` bounds the relative residual of collocation: 1e-9 gives the
    tip to about 1e-12 L, below 1e-10 rounding is in the way. `cold`: from the straight arm at full load.
    `max_change` limits x/L, y/L, theta, beta per load step, `min_step` is where raising the load is given up.
    """
    rod = Rod(scene)
    last = straight(rod, 1.0) if cold else march(rod, max_change, min_step)
    message = "the passes for beta' did not settle"
    if last is None:  # only from `cold`
        last, message = straight(rod, 0.0), "no equilibrium found from the straight arm"
    elif last.load < 1:
        cause = "no volume-preserving beta" if last.margin < 0.3 else "limit point or instability"
        message = f"{cause} beyond {last.load:.6f} of the load"
    for _ in range(20 if last.load == 1 else 0):
        finer = collocate(rod, 1.0, last.xi, last.curve(last.xi), last.next_slope, tol, 8000)
        if finer is None:
            message = "collocation did not reach the tolerance"
            break
        moved, last = np.abs(finer.curve(1.0) - last.curve(1.0)).max(), finer
        if moved < 0.1 * tol:
            message = "converged"
            break

    def fields(s: Array | float) -> dict[str, Array]:
        s = np.atleast_1d(np.asarray(s, dtype=float))
        piece = np.maximum(np.searchsorted(rod.start[:, 0], s - 1e-12 * rod.length) - 1, 0)
        xi = (s - rod.start[piece, 0]) / rod.span[piece, 0]
        points, state, bulge = rod.start + rod.span * xi, rod.unpack(last.curve(xi)), last.slope(xi)[0]
        k, total = rod.section(points, state, bulge), rod.total(points, state, last.load, bulge)
        f_x, f_y = np.array([[np.cos(state[2]), -np.sin(state[2])], [np.sin(state[2]), np.cos(state[2])]])
        values = dict(zip(NAMES, state, strict=True)) | {"nu": k.nu, "eta": k.eta, "m": k.bending * state[5]}
        values |= {"Fx": (f_x * total[:2]).sum(axis=0), "Fy": (f_y * total[:2]).sum(axis=0), "M": total[2]}
        return {name: value[piece, np.arange(len(s))] for name, value in values.items()}

    def displacements() -> Array:
        nodes, weights = np.polynomial.legendre.leggauss(6)
        step = np.diff(last.xi)[:, None]
        xi, weight = (last.xi[:-1, None] + step * (nodes + 1) / 2).ravel(), (step * weights / 2).ravel()
        k = rod.section(rod.start + rod.span * xi, rod.unpack(last.curve(xi)), last.slope(xi)[0])
        shorter = np.hypot(1.0, rod.offset_slope) - np.hypot(k.d_a, k.d_b) * k.stretch
        return (shorter * rod.reaches * rod.span * weight).sum(axis=(1, 2))

    tip = {name: value.item() for name, value in fields(rod.length).items()}
    outcome = {"converged": message == "converged", "message": message, "load_fraction": last.load}
    return SimpleNamespace(**outcome, **tip, fields=fields, displacements=displacements())


def random_scene(rng: np.random.Generator) -> Scene:
    """A solvable scene of a kind drawn by chance, around the paper's octopus arm."""
    uniform, length, sign = rng.uniform, 0.418, int(rng.choice([-1, 1]))

    def muscle(low: float, high: float, side: int = 1, end: float = length, kind: str = "unnormalized") -> Scene:
        base, stop = 0.012 * uniform(0.7, 1.0), (0.012 - 0.011 * end / length) * uniform(0.8, 1.2)
        pull = {"side": side, "tension": uniform(low, high), "tangent": kind}
        return pull | {"base_offset": base, "end_offset": stop, "end": end}

    arm = {"length": length, "base_radius": 0.015, "tip_radius": 0.004, "density": 1100.0}
    arm |= {"youngs_modulus": 1e7, "poisson_ratio": 0.5}
    speed, softness, main = uniform(0.05, 0.5), 10 ** uniform(-1, 0), muscle(2, 20)
    water = {"density": 998.0, "viscosity": 1.002e-3, "velocity": speed, "boundary_layer": 0.02}
    gentle = {"muscles": [muscle(softness, 8 * softness)], "water": water | {"velocity": 0.3 * sign * speed}}
    soft = {"tip_radius": uniform(0.0015, 0.004), "youngs_modulus": 1e7 * softness}
    short = [muscle(2, 15, sign, length * uniform(0.2, 0.5)), muscle(2, 15, -1, length * uniform(0.5, 0.9))]
    unit = [muscle(2, 20, kind="unit"), muscle(2, 10, -1, 0.6 * length, kind="unit")]
    tip = {"force": (uniform(-0.2, 0.2), uniform(-0.2, 0.2)), "moment": uniform(-0.003, 0.003)}
    kinds: list[Scene] = [
        {"muscles": [main, *short[: rng.integers(1, 3)]]},
        {"muscles": [main, muscle(2, 20, -1)]},
        {"muscles": [muscle(20, 45)]},
        {"muscles": unit, "arm": arm | {"cross_section": "rigid"}},
        {"arm": arm | {"cross_section": "rigid", "poisson_ratio": uniform(0.2, 0.5)}},
        {"arm": arm | {"base_angle": uniform(-1.5, 1.5), "stiffness_factor": uniform(1, 2)}},
        {"arm": arm | {"ventral": -1}, "water": water | {"velocity": sign * speed}},
        {"arm": arm | soft, **gentle},
        {"water": None},
        {"water": water | {"velocity": -speed}},
        {"water": water | {"velocity": 2 * speed}},
        {"water": water | {"velocity_gradient": uniform(-2, 2), "inlet_fraction": uniform(0.2, 1)}},
        {"tip": tip},
        {"tip": tip | {"follower": True}},
    ]
    scene = {"arm": arm, "gravity": {"acceleration": 9.81}, "water": water, "muscles": [main]}
    scene |= kinds[rng.integers(len(kinds))]
    return {part: value for part, value in scene.items() if value is not None}
