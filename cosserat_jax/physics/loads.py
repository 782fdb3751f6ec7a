"""Loads spread along the arm: each says what it does to a cross-section."""

import abc
from typing import Any, NamedTuple

import equinox as eqx

from ..scene.quantity import Scalar


class DeformedSection(NamedTuple):
    """A cross-section of the deformed arm, as a load sees it.

    - `s` [m]: its arc length on the undeformed centerline, 0 at the base.
    - `x`, `y` [m]: its place; `cos`, `sin`: its director a. The director b is (-sin, cos).
    - `nu`, `eta`, `mu` [1/m]: stretch, shear, curvature; `beta` and `beta_s` [1/m]: cross-section scale and its slope.
    - `radius` R [m] of the undeformed section; the ventral surface runs at r + X beta b, `surface` X = ventral R,
      `surface_slope` X_s.
    """

    s: Any
    x: Any
    y: Any
    cos: Any
    sin: Any
    nu: Any
    eta: Any
    mu: Any
    beta: Any
    beta_s: Any
    radius: Any
    surface: Any
    surface_slope: Any


class AbstractLoad(eqx.Module):
    """A load per undeformed length of the centerline. A user's own load is a subclass, put into `Scene(loads=(...,))`:

        class Spring(AbstractLoad):
            stiffness: float  # [N/m^2]

            def per_length(self, section):
                return 0.0, -self.stiffness * section.y, 0.0

    Its float fields are parameters like any other, at paths such as `loads.0.stiffness`. A load is raised in proportion
    with all others, so `per_length` says what it is at full load.
    """

    @property
    def depends_on_position(self) -> bool:
        """Whether `per_length` reads x or y, for which shooting has three unknowns instead of one. A load that does not
        may override this to say False."""
        return True

    @abc.abstractmethod
    def per_length(self, section: DeformedSection) -> tuple[Scalar, Scalar, Scalar]:
        """Force along e1 and e2 [N/m] and moment about the centerline [N m/m] at a cross-section.

        Written with operations of `jax.numpy` that act element by element: the fields of `section` are arrays over many
        sections of many rods, and the results may be of any shape that broadcasts with them.
        """
