"""Shared by all tests: shapes and dtypes in signatures are checked, promotions and warnings are errors."""

import jax

jax.config.update("jax_numpy_rank_promotion", "raise")
