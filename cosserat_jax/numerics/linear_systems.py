"""Small systems of linear equations, [n, n, ...]: the batch comes last, and one, two or three unknowns cost no library
call."""

import jax.numpy as jnp
from jaxtyping import Array, Float

Matrix = Float[Array, "n n ..."]


def solve(matrix: Matrix, rhs: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """The x of matrix x = rhs."""
    n = len(matrix)
    if n == 1:
        return rhs / matrix[0]
    if n == 2:
        (a, b), (c, d) = matrix
        return jnp.stack([d * rhs[0] - b * rhs[1], a * rhs[1] - c * rhs[0]]) / (a * d - b * c)[None]
    if n == 3:
        columns = [matrix[:, i] for i in range(3)]
        normals = [_cross(columns[(i + 1) % 3], columns[(i + 2) % 3]) for i in range(3)]
        determinant = _dot(columns[0], normals[0])
        return jnp.stack([_dot(rhs, normal) for normal in normals]) / determinant[None]
    return jnp.moveaxis(jnp.linalg.solve(_leading(matrix), jnp.moveaxis(rhs, 0, -1)[..., None])[..., 0], -1, 0)


def solve_columns(matrix: Matrix, rhs: Float[Array, "n columns ..."]) -> Float[Array, "n columns ..."]:
    """`solve` of every column."""
    if len(matrix) <= 3:
        return solve(matrix[:, :, None], rhs)
    return jnp.moveaxis(jnp.linalg.solve(_leading(matrix), _leading(rhs)), (-2, -1), (0, 1))


def determinant(matrix: Matrix) -> Float[Array, "..."]:
    """det(matrix)."""
    n = len(matrix)
    if n == 1:
        return matrix[0, 0]
    if n == 2:
        return matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    if n == 3:
        return _dot(matrix[:, 0], _cross(matrix[:, 1], matrix[:, 2]))
    return jnp.linalg.det(_leading(matrix))


def inverse(matrix: Matrix) -> Matrix:
    """matrix^-1."""
    n = len(matrix)
    eye = jnp.eye(n).reshape(n, n, *(1,) * (matrix.ndim - 2))
    return solve_columns(matrix, jnp.broadcast_to(eye, matrix.shape))


def product(matrix: Float[Array, "m n ..."], vector: Float[Array, "n ..."]) -> Float[Array, "m ..."]:
    """matrix times vector."""
    return (matrix * vector[None]).sum(1)


def condition_number(matrix: Matrix) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """max(1, |A|) max(1, |A^-1|) of a matrix between like quantities, and |A^-1|.

    One unknown has a condition number of 1 whatever the matrix; held against the unit matrix it tells both an
    amplification and a singularity. The norms are Frobenius's.
    """
    norm, of_inverse = (jnp.sqrt((m**2).sum((0, 1))) for m in (matrix, inverse(matrix)))
    return jnp.maximum(norm, 1.0) * jnp.maximum(of_inverse, 1.0), of_inverse


def _leading(matrix: Matrix) -> Array:
    return jnp.moveaxis(matrix, (0, 1), (-2, -1))


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Array, b: Array) -> Array:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
