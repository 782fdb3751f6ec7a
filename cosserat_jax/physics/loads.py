"""Loads spread along the arm: each says what it does to a cross-section, and whether it asks where that is."""

import abc
from typing import NamedTuple

import equinox as eqx

from ..scene.quantity import Scalar


class CrossSection(NamedTuple):
    """A cross-section in its place: centerline (x, y) [m], director (cos, sin), strains, radius R, surface offset X.

    The deformed surface runs at x = r + X beta b with X = ventral R; `surface_slope` is X_s.
    """

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    nu: Scalar
    eta: Scalar
    mu: Scalar
    beta: Scalar
    beta_s: Scalar
    radius: Scalar
    surface: Scalar
    surface_slope: Scalar


class AbstractLoad(eqx.Module):
    """A load per undeformed length of the centerline."""

    @property
    @abc.abstractmethod
    def depends_on_position(self) -> bool:
        """Whether `per_length` reads x or y: shooting then has three unknowns instead of one."""

    @abc.abstractmethod
    def per_length(self, section: CrossSection) -> tuple[Scalar, Scalar, Scalar]:
        """Force along e1 and e2 [N/m] and moment about the centerline [N m/m] at a cross-section."""
