"""Rubber under large strain: stress and its slope from the deformation gradient F and a pressure-like field p.

The energy per undeformed volume, with J = det F and the invariants I1 = tr C, I2 = (I1^2 - tr C^2) / 2 of C = F^T F, is

    W = c1 (I1 - 3) + c2 (I2 - 3) - (2 c1 + 4 c2) ln J + p (J - 1) - p^2 / (2 lambda)

neo-Hookean where c2 = 0, else Mooney-Rivlin (Mooney 1940, Rivlin 1948). The modulus of shear is G = 2 (c1 + c2), and
lambda = 2 G nu_p / (1 - 2 nu_p) is Lame's: p is lambda (J - 1), or where nu_p = 1/2 Lagrange's multiplier of J = 1. The
stress is linear elasticity at small strains, and p is zero in the undeformed arm.
"""

from typing import NamedTuple

import numpy as np

from .arm import Arm, Array


class Rubber(NamedTuple):
    """c1, c2 [Pa] and 1 / lambda [1/Pa], zero where the volume is kept."""

    c1: float
    c2: float
    compliance: float

    @classmethod
    def of(cls, arm: Arm, mooney: float = 0.0) -> "Rubber":
        """With the arm's modulus and Poisson's ratio, above zero; `mooney` is the share of c2 in c1 + c2."""
        shear = arm.modulus / (2 * (1 + arm.poisson_ratio))
        compliance = (1 - 2 * arm.poisson_ratio) / (2 * shear * arm.poisson_ratio)
        return cls(shear / 2 * (1 - mooney), shear / 2 * mooney, compliance)

    def stress(self, f: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        """First Piola-Kirchhoff stress P = dW/dF [..., 3, 3], its slope [..., 3, 3, 3, 3] in F, cof F and J."""
        eye = np.eye(3)
        volume, inverse = np.linalg.det(f), np.linalg.inv(f)
        log, along = 2 * self.c1 + 4 * self.c2, volume[..., None, None]
        cofactor = along * np.swapaxes(inverse, -1, -2)
        pressure = (p * volume - log)[..., None, None]
        piola = 2 * self.c1 * f + pressure * np.swapaxes(inverse, -1, -2)
        slope = np.broadcast_to(2 * self.c1 * np.einsum("ik,JL->iJkL", eye, eye), (*f.shape, 3, 3)).copy()
        slope += (p * volume)[..., None, None, None, None] * np.einsum("...Ji,...Lk->...iJkL", inverse, inverse)
        slope -= pressure[..., None, None] * np.einsum("...Jk,...Li->...iJkL", inverse, inverse)
        if self.c2:
            c = np.swapaxes(f, -1, -2) @ f
            left = f @ np.swapaxes(f, -1, -2)
            trace = np.trace(c, axis1=-2, axis2=-1)[..., None, None]
            piola = piola + 2 * self.c2 * (trace * f - f @ c)
            slope += (
                2
                * self.c2
                * (
                    2 * np.einsum("...iJ,...kL->...iJkL", f, f)
                    + np.einsum("...JL,ik->...iJkL", trace * eye - c, eye)
                    - np.einsum("...iL,...kJ->...iJkL", f, f)
                    - np.einsum("...ik,JL->...iJkL", left, eye)
                )
            )
        return piola, slope, cofactor, volume
