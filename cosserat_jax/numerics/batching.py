"""Functions of a whole batch as JAX operations: `jax.vmap` makes their batch larger instead of rewriting them.

A `BatchFunction` computes with the batch as the last axis of its arrays, which is how a CPU's vector units are filled.
JAX's own batching rule would put the new axis first, and turn the arrays around each operation. So the function is one
operation to JAX, `apply`, whose batching rule moves the new axis to the end and merges it with the batch that is there.
An argument without a batch axis is shared by all members of the batch.
"""

import abc
import dataclasses
import functools as ft
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array


class BatchFunction(abc.ABC):
    """A function of arrays with the batch on the last axis. Hashable: equal ones share their compiled programs.

    - `ranks`: the number of axes of each argument without the batch.
    - `chunk`: the most members that are computed at a time; more are computed in turn by the same program.
    """

    ranks: tuple[int, ...]
    chunk: int = 512

    @abc.abstractmethod
    def results(self, *shapes: tuple[int, ...]) -> list[ShapedArray]:
        """The results without the batch, from the shapes of the arguments without it."""

    @abc.abstractmethod
    def compute(self, *arguments: Array) -> Sequence[Array]:
        """The results [..., batch] of arguments [..., batch], or [...] where the batch shares one."""


class LinearFunction(BatchFunction):
    """One that is linear in its last argument, the vectors [vectors, size], and has one result, [vectors, size]: more
    vectors for the same other arguments share all work that is not linear."""

    @abc.abstractmethod
    def transposed(self) -> "LinearFunction":
        """The transpose: a function of the same other arguments."""


def apply(function: BatchFunction, *arguments: Array) -> list[Array]:
    """The results of `function`, with a batch axis at the end if any argument has one."""
    return _batched_p.bind(*arguments, function=function)


def _has_batch(function: BatchFunction, arguments: Sequence[Any]) -> list[bool]:
    return [jnp.ndim(a) > rank for a, rank in zip(arguments, function.ranks, strict=True)]


def _compute(*arguments: Array, function: BatchFunction) -> list[Array]:
    """Runs the function, over chunks where the batch is large, and with a batch of one where there is none.

    What all members share has fewer axes than what each has of its own, and the two may always meet, also where the
    user has JAX raise an error for that.
    """
    with jax.numpy_rank_promotion("allow"):
        return _chunked(*arguments, function=function)


def _chunked(*arguments: Array, function: BatchFunction) -> list[Array]:
    batched = _has_batch(function, arguments)
    if not any(batched):
        arguments = (*arguments[:-1], arguments[-1][..., None])
        return [result[..., 0] for result in function.compute(*arguments)]
    size = next(a.shape[-1] for a, b in zip(arguments, batched, strict=True) if b)
    count = math.ceil(size / function.chunk)
    if count <= 1:
        return list(function.compute(*arguments))
    chunk = math.ceil(size / count)

    def one(number: Array, results: list[Array]) -> list[Array]:
        start = jnp.minimum(number * chunk, size - chunk)  # the last chunk may overlap the one before
        taken = [
            lax.dynamic_slice_in_dim(a, start, chunk, -1) if b else a for a, b in zip(arguments, batched, strict=True)
        ]
        new = function.compute(*taken)
        return [lax.dynamic_update_slice_in_dim(r, n, start, -1) for r, n in zip(results, new, strict=True)]

    shapes = [a.shape[:rank] for a, rank in zip(arguments, function.ranks, strict=True)]
    empty = [jnp.zeros((*result.shape, size), result.dtype) for result in function.results(*shapes)]
    return lax.fori_loop(0, count, one, empty)


_batched_p = Primitive("batched")
_batched_p.multiple_results = True


@ft.partial(jax.jit, static_argnames="function")
def _jitted(*arguments: Array, function: BatchFunction) -> list[Array]:
    return _compute(*arguments, function=function)


@_batched_p.def_impl
def _impl(*arguments: Array, function: BatchFunction) -> list[Array]:
    return _jitted(*arguments, function=function)


@_batched_p.def_abstract_eval
def _abstract(*arguments: Any, function: BatchFunction) -> list[ShapedArray]:
    bare = [a.shape[:rank] for a, rank in zip(arguments, function.ranks, strict=True)]
    sizes = {a.shape[-1] for a, rank in zip(arguments, function.ranks, strict=True) if a.ndim > rank}
    if len(sizes) > 1:
        raise TypeError(f"arguments of different batch sizes: {sorted(sizes)}")
    return [ShapedArray((*result.shape, *sizes), result.dtype) for result in function.results(*bare)]


def _batch(arguments: Sequence[Array], dims: Sequence[Any], *, function: BatchFunction) -> tuple[list, list]:
    size = next(a.shape[d] for a, d in zip(arguments, dims, strict=True) if d is not None)
    new = [d is not None for d in dims]
    if isinstance(function, LinearFunction) and not any(new[:-1]):
        vectors = jnp.moveaxis(arguments[-1], dims[-1], 0)
        many = vectors.reshape(-1, *vectors.shape[2:])
        (result,) = apply(function, *arguments[:-1], many)
        return [result.reshape(*vectors.shape[:2], *result.shape[1:])], [0]
    old = [jnp.ndim(a) - n > rank for a, n, rank in zip(arguments, new, function.ranks, strict=True)]
    inner = next((a.shape[-1] if d != a.ndim - 1 else a.shape[-2]
                  for a, d, o in zip(arguments, dims, old, strict=True) if o), None)  # fmt: skip
    merged = []
    for a, d, n, o in zip(arguments, dims, new, old, strict=True):
        if n and inner is None:
            a = jnp.moveaxis(a, d, -1)
        elif n or o:  # to [..., size, inner], which becomes one axis
            a = jnp.moveaxis(a, d, -2 if o else -1) if n else a[..., None, :]
            a = a if o else a[..., None]
            a = jnp.broadcast_to(a, (*a.shape[:-2], size, inner)).reshape(*a.shape[:-2], -1)
        merged.append(a)
    results = apply(function, *merged)
    if inner is None:
        return results, [r.ndim - 1 for r in results]
    return [r.reshape(*r.shape[:-1], size, inner) for r in results], [r.ndim - 1 for r in results]


def _transpose(cotangents: Sequence[Any], *arguments: Any, function: LinearFunction) -> list[Any]:
    *known, vector = arguments
    assert ad.is_undefined_primal(vector), "linear in the last argument alone"
    (cotangent,) = cotangents
    if type(cotangent) is ad.Zero:
        return [None] * len(known) + [ad.Zero(vector.aval)]
    (back,) = apply(function.transposed(), *known, cotangent)
    return [None] * len(known) + [back.sum(-1) if back.ndim > vector.aval.ndim else back]


def _jvp(arguments: Sequence[Array], tangents: Sequence[Any], *, function: BatchFunction) -> tuple[list, list]:
    """Of a linear function by its vectors; by the other arguments in forward mode, see `Directional`."""
    if not isinstance(function, LinearFunction):
        raise TypeError(f"{type(function).__name__} has no derivative of its own")
    *known, vector = arguments
    results = apply(function, *arguments)
    moving = tuple(i for i, tangent in enumerate(tangents[:-1]) if type(tangent) is not ad.Zero)
    changes = []
    if type(tangents[-1]) is not ad.Zero:
        changes += apply(function, *known, tangents[-1])
    if moving:
        directional = Directional(function, moving)
        (change,) = apply(directional, *known, vector, directional.packed([tangents[i] for i in moving]))
        changes.append(change.reshape(results[0].shape))
    return results, [sum(changes[1:], changes[0]) if changes else ad.Zero(results[0].aval)]


@dataclasses.dataclass(frozen=True)
class Directional(LinearFunction):
    """The derivative of a function with one result in a direction, all `moving` arguments packed into one vector.

    The vectors are [1, size], the result [1, size of the result]. The transpose takes as many forward passes as the
    moving arguments have entries: for second and higher derivatives, where no loop may be run backwards.
    """

    function: BatchFunction
    moving: tuple[int, ...]
    is_transposed: bool = False

    @property
    def ranks(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (*self.function.ranks, 2)

    @property
    def chunk(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return max(1, self.function.chunk // 8)

    def packed(self, values: Sequence[Array]) -> Array:
        """The moving arguments, or changes of them, as one vector [1, size], with the batch behind if one has it."""
        flat, ranks = [], [self.function.ranks[i] for i in self.moving]
        batches = {jnp.shape(value)[-1] for value, rank in zip(values, ranks, strict=True) if jnp.ndim(value) > rank}
        for value, rank in zip(values, ranks, strict=True):
            if batches and jnp.ndim(value) == rank:
                value = jnp.broadcast_to(jnp.asarray(value)[..., None], (*jnp.shape(value), *batches))
            flat.append(jnp.reshape(value, (1, -1, *batches)))
        return jnp.concatenate(flat, axis=1)

    def results(self, *shapes: tuple[int, ...]) -> list[ShapedArray]:
        shape = self.function.results(*shapes[:-1])[0].shape
        sizes = [math.prod(shapes[i]) for i in self.moving]
        size = sum(sizes) if self.is_transposed else math.prod(shape)
        return [ShapedArray((shapes[-1][0], size), jnp.dtype(float))]

    def transposed(self) -> "Directional":
        return dataclasses.replace(self, is_transposed=not self.is_transposed)

    def compute(self, *arguments: Array) -> list[Array]:
        *at, vectors = arguments
        batch = next(a.shape[-1] for a, rank in zip(arguments, self.ranks, strict=True) if jnp.ndim(a) > rank)
        ranks = self.function.ranks

        def spread(a: Array, rank: int) -> Array:
            return jnp.broadcast_to(a[..., None], (*a.shape, batch)) if a.ndim == rank else a

        moving = [spread(at[i], ranks[i]) for i in self.moving]

        def of(packed: Array) -> Array:
            parts, start = list(at), 0
            for i, value in zip(self.moving, moving, strict=True):
                size = math.prod(value.shape[:-1])
                parts[i] = packed[start : start + size].reshape(value.shape)
                start += size
            return self.function.compute(*parts)[0].reshape(-1, batch)

        place = self.packed(moving)[0]
        if not self.is_transposed:
            shape = (*vectors.shape[:2], batch)
            vectors = jnp.broadcast_to(spread(vectors, 2), shape)
            return [lax.map(lambda vector: jax.jvp(of, (place,), (vector,))[1], vectors)]

        def row(unit: Array) -> Array:
            _, change = jax.jvp(of, (place,), (jnp.broadcast_to(unit[:, None], place.shape),))
            return (change * spread(vectors, 2)).sum(1)

        return [jnp.moveaxis(lax.map(row, jnp.eye(len(place))), 0, 1)]


batching.primitive_batchers[_batched_p] = _batch
ad.primitive_transposes[_batched_p] = _transpose
ad.primitive_jvps[_batched_p] = _jvp
mlir.register_lowering(_batched_p, mlir.lower_fun(_compute, multiple_results=True))
