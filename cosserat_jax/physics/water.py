"""The force of steady water on the arm."""

import jax.numpy as jnp

from ..scene import Water
from ..scene.quantity import Scalar
from .loads import AbstractLoad, DeformedSection


class Flow(AbstractLoad):
    """Momentum, tangential and viscous force of the water on the ventral surface, and its moment about the centerline.

        u_t = x_s / |x_s|    u_n = ventral k x u_t    v_t = v_inf e1.u_t    v_n = v_inf e1.u_n    q = pi rho_w beta R
        f = q |v_n| v_n u_n + q (v_n^2 + 2 inlet_fraction v_t v_n) u_t - (2 pi R beta mu_v v_t / h_inf) u_t
        m = (X beta b) x f

    The first term is the momentum of the water that the surface stops, pushing the way the water goes; the others are
    the paper's Eqs. ForceLeftTangentRod and FrictionForce_dFvis with their signs as printed. The current may change
    with height over the base, v_inf = velocity + velocity_gradient y.
    """

    water: Water

    @property
    def depends_on_position(self) -> bool:
        return self.water.velocity_gradient is not None

    def per_length(self, section: DeformedSection) -> tuple[Scalar, Scalar, Scalar]:
        water = self.water
        speed = water.velocity
        if water.velocity_gradient is not None:
            speed = speed + water.velocity_gradient * section.y

        # the tangent x_s of the surface, in the section's own frame, then in the fixed one
        along = section.nu - section.surface * section.beta * section.mu
        across = section.eta + section.surface_slope * section.beta + section.surface * section.beta_s
        shorter = 1 / jnp.sqrt(along**2 + across**2)
        t1 = (along * section.cos - across * section.sin) * shorter
        t2 = (along * section.sin + across * section.cos) * shorter

        # u_n = ventral (-t2, t1); the ventral sign drops out of |v_n| v_n u_n but not out of v_t v_n
        ventral = jnp.sign(section.surface)
        v_t, v_n = speed * t1, -ventral * speed * t2
        girth = jnp.pi * section.beta * section.radius
        normal = water.density * girth * jnp.abs(v_n) * v_n * ventral
        tangential = water.density * girth * (v_n**2 + 2 * water.inlet_fraction * v_t * v_n)
        tangential -= 2 * girth * water.viscosity * v_t / water.boundary_layer
        f1 = tangential * t1 - normal * t2
        f2 = tangential * t2 + normal * t1
        # (X beta b) x f with b = (-sin, cos)
        moment = -section.surface * section.beta * (section.sin * f2 + section.cos * f1)
        return f1, f2, moment
