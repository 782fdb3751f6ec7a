"""Shared by all tests: a rank that grows by itself is an error."""

import jax

jax.config.update("jax_numpy_rank_promotion", "raise")
