"""What the Jacobian at a minimum says of the parameters: standard errors, correlations, what cannot be told apart."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_COLLINEAR = 30.0  # condition index from which parameters count as not told apart (Belsley, Kuh & Welsch 1980)
_SHARE = 0.5  # of a parameter's variance that such an index must hold
_NOTHING = 1e-10  # singular value, of columns of length 1, below which there is no information at all


class Uncertainty(NamedTuple):
    """Of p parameters: covariance, standard errors and correlations; and by what they cannot be told apart.

    With J = d misfits / d parameters, misfits r in units of their standard error,

        covariance = s^2 (J^T J)^-1        s^2 = 1, or r.r / (values - p) where the standard error is not known

    `indices` are the condition indices of J with its columns scaled to length 1, largest singular value over each, and
    `shares[k, i]` the part of parameter i's variance that index k holds (Belsley, Kuh & Welsch, Regression Diagnostics,
    1980). A parameter on which nothing depends has an infinite standard error.
    """

    covariance: Float[Array, "*batch p p"]
    stderr: Float[Array, "*batch p"]
    correlation: Float[Array, "*batch p p"]
    indices: Float[Array, "*batch p"]
    shares: Float[Array, "*batch p p"]


def uncertainty(
    jacobian: Float[Array, "values p"], misfits: Float[Array, " values"], taken: int, sigma_known: bool
) -> Uncertainty:
    """See `Uncertainty`; `taken` of the values count, the misfits of the others are zero."""
    params = jacobian.shape[1]
    lengths = jnp.linalg.norm(jacobian, axis=0)
    scale = jnp.where(lengths > 0, lengths, 1.0)
    padded = jnp.concatenate([jacobian / scale[None], jnp.zeros((params, params))])  # at least as many rows as columns
    _, singular, basis = jnp.linalg.svd(padded, full_matrices=False)
    safe = jnp.maximum(singular, _NOTHING)
    parts = (basis / safe[:, None]) ** 2
    covariance = (basis.T / safe[None] ** 2) @ basis / jnp.outer(scale, scale)
    dof = taken - params
    variance = 1.0 if sigma_known else (jnp.sum(misfits**2) / dof if dof > 0 else jnp.inf)
    unknown = (lengths == 0) | (jnp.sum(jnp.where(singular < _NOTHING, 1.0, 0.0)[:, None] * basis**2, axis=0) > 1e-6)
    spread = jnp.sqrt(jnp.diag(covariance))
    stderr = jnp.where(unknown, jnp.inf, spread * jnp.sqrt(variance))
    return Uncertainty(
        covariance=covariance * variance,
        stderr=stderr,
        correlation=covariance / jnp.outer(spread, spread),
        indices=jnp.max(singular, initial=0.0) / safe,
        shares=parts / parts.sum(axis=0)[None],
    )


def not_told_apart(found: Uncertainty) -> list[tuple[int, ...]]:
    """The sets of two and more parameters that the data do not tell apart, by their numbers, worst first."""
    sets = []
    for index, shares in sorted(
        zip(np.asarray(found.indices), np.asarray(found.shares), strict=True), key=lambda p: -p[0]
    ):
        members = tuple(int(i) for i in np.flatnonzero(shares > _SHARE))
        if index > _COLLINEAR and len(members) > 1:
            sets.append(members)
    return sets
