"""The same rods in other solvers: SciPy's `solve_bvp`, SoRoMoX, Exudyn and PyElastica, static equilibrium of each.

Every `by_` function takes a scene of the package and how fine to be, and gives back a call that solves it and returns
the tip [m]. Packages are imported where they are used; none but SciPy is a dependency of the project.

- SciPy: the octopus arm of the paper, written for speed. Four unknowns (angle, total force and moment), the stretch of
  the section and its slope found at all points of the mesh at once, the whole Jacobian in one call.
- SoRoMoX: piecewise constant strain; Newton's method on the balance of its generalized forces.
- Exudyn: geometrically exact beams of three nodes, its own static solver.
- PyElastica: discrete elastic rods, which it only moves through time, so damped until they come to rest.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosserat_jax import Scene, load_scene, replace

Array = NDArray[np.float64]
Tip = tuple[float, float]


def by_scipy(scene: Scene, tol: float) -> Callable[[], Tip]:
    """An arm in a uniform current, bent by one muscle to its tip, tangent unnormalized; from the straight arm."""
    from scipy.integrate import solve_bvp

    # out of the scene once: looking into its modules costs time
    arm, muscle, water = (SimpleNamespace(**vars(part)) for part in (scene.arm, scene.muscles[0], scene.water))
    length, young, pull = arm.length, arm.stiffness_factor * arm.youngs_modulus, muscle.tension
    shear = young / (2 * (1 + arm.poisson_ratio))
    taper = (arm.tip_radius - arm.base_radius) / length
    offset_s = muscle.side * (muscle.end_offset - muscle.base_offset) / length
    excess = (arm.density - water.density) * scene.gravity.acceleration
    force = young * np.pi * (arm.base_radius + arm.tip_radius) ** 4 / 64 / length**2
    size = np.array([[1.0], [force], [force], [force * length]])

    def strains(s: Array, axial: Array, moment: Array) -> tuple[Array, ...]:
        """Stretch beta, nu, mu, the inverse of the section's stiffness at them, and dg/dbeta of the constraint g."""
        radius, offset = arm.base_radius + taper * s, muscle.side * muscle.base_offset + offset_s * s
        area, surface, beta = np.pi * radius**2, arm.ventral * radius, np.ones_like(s)
        for _ in range(12):
            stretched, at = area * beta**2, offset * beta
            k11, k12 = young * stretched + pull, -pull * at
            k22 = young * stretched * (beta * radius) ** 2 / 4 + pull * at**2
            inverse = 1 / (k11 * k22 - k12**2)
            load = axial + young * stretched
            nu, mu = (k22 * load - k12 * moment) * inverse, (k11 * moment - k12 * load) * inverse
            d1 = 2 * young * stretched / beta * (1 - nu) + pull * offset * mu
            d2 = pull * offset * nu - (young * stretched * beta * radius**2 + 2 * pull * at * offset) * mu
            nu_b, mu_b = (k22 * d1 - k12 * d2) * inverse, (k11 * d2 - k12 * d1) * inverse
            slope = nu - 2 * surface * beta * mu + beta * (nu_b - surface * beta * mu_b)
            step = (beta * (nu - surface * beta * mu) - 1) / slope
            if np.abs(step).max() < 1e-12:
                break
            beta = beta - step
        return radius, offset, surface, stretched, beta, nu, mu, (k11, k12, k22, inverse), slope

    def everything(s: Array, state: Array) -> tuple[Array, Array, Array]:
        """Slopes of the four unknowns, and of x and y."""
        theta, force_x, force_y, moment = state
        cos, sin = np.cos(theta), np.sin(theta)
        axial, across = force_x * cos + force_y * sin, force_y * cos - force_x * sin
        radius, offset, surface, area, beta, nu, mu, (k11, k12, k22, inverse), slope = strains(s, axial, moment)
        v_surface, weight = arm.ventral * taper, excess * area * nu
        growth, girth, beta_s = 2 * taper / radius, np.pi * beta * radius, 0.0
        for _ in range(3):  # beta_s acts on itself, by a factor of 1e-4
            eta = (across - pull * (offset_s * beta + offset * beta_s)) / (shear * area + pull)
            along, aside = nu - surface * beta * mu, eta + v_surface * beta + surface * beta_s
            long = np.hypot(along, aside)
            t_x, t_y = (along * cos - aside * sin) / long, (along * sin + aside * cos) / long
            v_t, v_n = water.velocity * t_x, -arm.ventral * water.velocity * t_y
            normal = water.density * girth * np.abs(v_n) * v_n * arm.ventral
            tangential = water.density * girth * (v_n**2 + 2 * water.inlet_fraction * v_t * v_n)
            tangential = tangential - 2 * girth * water.viscosity * v_t / water.boundary_layer
            flow_x, flow_y = tangential * t_x - normal * t_y, tangential * t_y + normal * t_x
            force_y_s = weight - flow_y
            moment_s = eta * axial - nu * across + surface * beta * (sin * flow_y + cos * flow_x)
            axial_s = mu * across - flow_x * cos + force_y_s * sin
            d1 = axial_s + young * area * growth * (1 - nu) + pull * offset_s * beta * mu
            stiffer = 2 * growth * young * area * (beta * radius) ** 2 / 4 + 2 * pull * beta**2 * offset * offset_s
            d2 = moment_s + pull * offset_s * beta * nu - stiffer * mu
            nu_s, mu_s = (k22 * d1 - k12 * d2) * inverse, (k11 * d2 - k12 * d1) * inverse
            beta_s = -beta * (nu_s - beta * (v_surface * mu + surface * mu_s)) / slope
        return np.stack([mu, -flow_x, force_y_s, moment_s]), nu * cos - eta * sin, nu * sin + eta * cos

    def slopes(xi: Array, u: Array) -> Array:
        return everything(length * xi, u * size)[0] * length / size

    def jacobian(xi: Array, u: Array) -> Array:
        """All columns by forward differences in one call."""
        steps = np.concatenate([np.zeros((4, 1)), 1e-7 * np.eye(4)], axis=1)[:, :, None]
        moved = (u[:, None, :] + steps).reshape(4, -1)
        values = slopes(np.tile(xi, 5), moved).reshape(4, 5, -1)
        return (values[:, 1:] - values[:, :1]) / 1e-7

    def ends(base: Array, tip: Array) -> Array:
        return np.array([base[0] - arm.base_angle, *tip[1:]])

    at_base, at_tip = np.diag([1.0, 0.0, 0.0, 0.0]), np.diag([0.0, 1.0, 1.0, 1.0])
    nodes, weights = np.polynomial.legendre.leggauss(4)

    def call() -> Tip:
        xi = np.linspace(0.0, 1.0, 11)
        start = np.zeros((4, xi.size))
        start[0] = arm.base_angle
        found = solve_bvp(
            slopes, ends, xi, start, tol=tol, fun_jac=jacobian, bc_jac=lambda *_: (at_base, at_tip), max_nodes=5000
        )
        if found.status != 0:
            return np.nan, np.nan
        step = np.diff(found.x)[:, None]
        places = (found.x[:-1, None] + step * (nodes + 1) / 2).ravel()
        share = length * (step * weights / 2).ravel()
        _, x_s, y_s = everything(length * places, found.sol(places) * size)
        return float(x_s @ share), float(y_s @ share)

    return call


def by_soromox(scene: Scene, segments: int) -> Callable[[], Tip]:
    """Newton's method on the balance of forces of a `PlanarPCS`, from the straight rod at full load, compiled."""
    import jax
    import jax.numpy as jnp
    from soromox.actuation import ThreadlikeActuator, ThreadlikeRouting
    from soromox.systems import LinkSpec, PlanarPCS

    arm, stiffness = scene.arm, scene.arm.stiffness
    piece = arm.length / segments
    link = LinkSpec.circular(
        length=piece, radius=arm.base_radius, density=arm.density, reference_strain=jnp.array([0.0, 1.0, 0.0]),
        stiffness=piece * jnp.diag(jnp.array([stiffness.bending, stiffness.axial, stiffness.shear])),
    )  # fmt: skip
    tendons = [
        ThreadlikeRouting.linear(
            intercept=jnp.array([0.0, muscle.side * muscle.base_offset, 0.0]), end_segment_index=segments - 1
        )
        for muscle in scene.muscles
    ]
    gravity = 0.0 if scene.gravity is None else scene.gravity.acceleration
    robot = PlanarPCS.from_links(
        [link] * segments, gravity=jnp.array([0.0, -gravity]), base_pose=jnp.zeros(3),
        actuators=tuple(ThreadlikeActuator.tendons(tendon) for tendon in tendons),
    )  # fmt: skip
    tensions = jnp.array([muscle.tension for muscle in scene.muscles])
    tip = jnp.zeros(3) if scene.tip is None else jnp.array([scene.tip.moment, *scene.tip.force])

    def unbalanced(q: Any) -> Any:
        forces = robot.elastic_force(q) + robot.gravitational_force(q)
        if scene.muscles:
            forces = forces - robot.actuation_force(q, tensions)
        return forces - robot.jacobian(q, jnp.asarray(arm.length)).T @ tip

    def iterate(state: tuple) -> tuple:
        q, _, count = state
        step = jnp.linalg.solve(jax.jacfwd(unbalanced)(q), unbalanced(q))
        return q - step, jnp.abs(step).max(), count + 1

    @jax.jit
    def equilibrium(q: Any) -> Any:
        q, last, _ = jax.lax.while_loop(lambda state: (state[1] > 1e-9) & (state[2] < 30), iterate, (q, jnp.inf, 0))
        return jnp.where(last > 1e-9, jnp.nan, robot.forward_kinematics(q, jnp.asarray(arm.length)))

    def call() -> Tip:
        _, x, y = np.asarray(equilibrium(jnp.zeros(3 * segments)))
        return float(x), float(y)

    return call


def by_exudyn(scene: Scene, elements: int) -> Callable[[], Tip]:
    """`SolveStatic` of a cantilever under a dead force on its tip, the model built anew each time."""
    import exudyn as exu
    from exudyn import itemInterface as items
    from exudyn.beams import GenerateBeamElementsAlongLine

    arm, stiffness, force = scene.arm, scene.arm.stiffness, scene.tip.force
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    settings.staticSolver.verboseMode = 0
    settings.staticSolver.numberOfLoadSteps = 3
    settings.staticSolver.newton.maxIterations = 50
    settings.linearSolverType = exu.LinearSolverType.EigenSparse

    def call() -> Tip:
        system = exu.SystemContainer().AddSystem()
        beam = items.ObjectBeamGeometricallyExact2D(
            nodeNumbers=[0, 0, 0], massPerLength=1.0, crossSectionInertia=1.0,
            bendingStiffness=stiffness.bending, axialStiffness=stiffness.axial, shearStiffness=stiffness.shear,
        )  # fmt: skip
        line = GenerateBeamElementsAlongLine(
            system, [0, 0, 0], [arm.length, 0, 0], elements, beam, groundConstraintsStart=[True] * 3
        )
        marker = system.AddMarker(items.MarkerNodePosition(nodeNumber=line["nodes"][-1]))
        system.AddLoad(items.Force(markerNumber=marker, loadVector=[*force, 0.0]))
        system.Assemble()
        system.SolveStatic(settings)
        x, y, _ = system.GetNodeOutput(line["nodes"][-1], exu.OutputVariableType.Position)
        return float(x), float(y)

    return call


def by_pyelastica(scene: Scene, elements: int, seconds: float = 2.5) -> Callable[[], Tip]:
    """A damped rod under a dead force on its tip, followed for so many seconds of its own time."""
    import elastica

    arm, stiffness, force = scene.arm, scene.arm.stiffness, scene.tip.force
    area, inertia = np.pi * arm.base_radius**2, np.pi * arm.base_radius**4 / 4
    turning = np.sqrt(stiffness.shear / (arm.density * inertia))  # fastest of the element's rates
    waves = 2 * elements / arm.length * np.sqrt(stiffness.axial / (arm.density * area))
    swing = 3.516 * np.sqrt(stiffness.bending / (arm.density * area)) / arm.length**2
    half = arm.length / (2 * elements - 1)  # of the first element, which is held as a whole: its middle is the base
    step = 1.0 / max(turning, waves)

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping): ...

    def relaxed(seconds: float) -> Tip:
        simulator = Simulator()
        rod = elastica.CosseratRod.straight_rod(
            elements, np.array([-half, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]),
            arm.length + half, arm.base_radius, arm.density,
            youngs_modulus=stiffness.bending / inertia, shear_modulus=stiffness.shear / area,
        )  # fmt: skip
        rod.shear_matrix[:] = np.diag([stiffness.shear, stiffness.shear, stiffness.axial])[:, :, None]
        simulator.append(rod)
        simulator.constrain(rod).using(
            elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
        )
        simulator.add_forcing_to(rod).using(
            elastica.EndpointForces, np.zeros(3), np.array([*force, 0.0]), ramp_up_time=step
        )
        simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=2 * swing, time_step=step)
        simulator.finalize()
        stepper, time = elastica.PositionVerlet(), np.float64(0.0)
        while time < seconds:
            time = stepper.step(simulator, time, np.float64(step))
        return float(rod.position_collection[0, -1]), float(rod.position_collection[1, -1])

    relaxed(10 * step)  # compiles it
    return lambda: relaxed(seconds)


class Trial(NamedTuple):
    """A scene in another solver: the package it comes in, and how fine it is to be, a quick run only as first said."""

    package: str
    module: str
    scene: str
    solver: Callable[[Scene, Any], Callable[[], Tip]]
    setting: str
    values: tuple[float, ...]


SCENES = {
    "octopus": load_scene("octopus"),
    # the preset elastica with the stretch and shear that its radius of 1 cm gives it
    "cantilever": replace(load_scene("elastica"), {"arm.stiffness.axial": 4e4, "arm.stiffness.shear": 4e4 / 3}),
    "tendon-robot, 15 N": replace(load_scene("tendon-robot"), {"muscles.0.tension": 15.0}),
}
# where the reference formulation of the tests is another model: its rod weighs more as it stretches
TIPS = {"tendon-robot, 15 N": (0.4532292709, -0.1822116945)}
TRIALS = (
    Trial("scipy", "scipy", "octopus", by_scipy, "tol", (1e-9, 1e-6, 1e-3)),
    Trial("soromox", "soromox", "cantilever", by_soromox, "segments", (4, 16)),
    Trial("exudyn", "exudyn", "cantilever", by_exudyn, "elements", (64, 16, 4)),
    Trial("pyelastica", "elastica", "cantilever", by_pyelastica, "elements", (20, 50)),
    Trial("soromox", "soromox", "tendon-robot, 15 N", by_soromox, "segments", (4, 16)),
)
