"""Posterior samples beside standard errors: NUTS (blackjax) on the density of a fit, against its Jacobian.

    python benchmarks/posterior.py [--quick]

Five tips of the octopus arm with a rigid section, modulus and inlet fraction free, measured to 0.05 mm, where the
density is all but a Gaussian and the two must agree, and to 2 mm, where it is not: the inlet fraction feels its bounds.
Needs the extra `posterior`. The sampler moves in `fit`'s unbounded parameters with the prior that is flat in values.
"""

from functools import partial

import blackjax
import jax
import jax.numpy as jnp
import numpy as np
from blackjax.diagnostics import effective_sample_size
from timing import line, machine, options, timed

from cosserat_jax import Calibration, fit, load_scene, log_density, replace, solve

CLAIM = """\
Claim: at 0.05 mm mean and spread of the samples agree with the fit's values and standard errors to within 10 % of the
       latter, sampling error included."""

CHAINS = 4
HIDDEN = {"arm.youngs_modulus": 8.3e6, "water.inlet_fraction": 0.62}
TENSIONS, CURRENTS = np.array([5.0, 20.0, 5.0, 20.0, 12.0]), np.array([0.2, 0.2, 0.4, 0.4, 0.6])


def fitted(sigma: float) -> Calibration:
    """A fit to noisy tips of the hidden arm."""
    arm = replace(load_scene("octopus"), {"arm.cross_section": "rigid"})
    hidden = replace(arm, HIDDEN)
    pairs = zip(TENSIONS, CURRENTS, strict=True)
    tips = [solve(replace(hidden, {"muscles.0.tension": t, "water.velocity": v})).tip for t, v in pairs]
    noise = np.random.default_rng(6).normal(scale=sigma, size=(2, len(tips)))
    data = {"muscles.0.tension [N]": TENSIONS, "water.velocity [m/s]": CURRENTS}
    data |= {f"tip.{k} [m]": np.array([getattr(tip, k) for tip in tips]) + noise[i] for i, k in enumerate("xy")}
    return fit(arm, data, list(HIDDEN), sigma=sigma)


def sampled(found: Calibration, warmup: int, count: int) -> jax.Array:
    """The free parameters' values in `count` samples of every chain, the chains side by side, after `warmup` steps of
    one that tune the sampler; of shape (chains, count, params)."""
    adapt = blackjax.window_adaptation(blackjax.nuts, log_density(found))
    tuning, sampling = jax.random.split(jax.random.key(0))
    (state, tuned), _ = adapt.run(tuning, found.minimum.u, num_steps=warmup)
    step = blackjax.nuts(log_density(found), **tuned).step

    def chain(key: jax.Array) -> jax.Array:
        keys = jax.random.split(key, count)
        return jax.lax.scan(lambda state, key: (after := step(key, state)[0], after.position), state, keys)[1]

    positions = jax.vmap(chain)(jax.random.split(sampling, CHAINS))
    return jax.vmap(jax.vmap(found.problem.unbounded.array))(positions)


def main(warmup: int, count: int) -> bool:
    machine()
    agree = []
    for sigma in (5e-5, 2e-3):
        found = fitted(sigma)
        chains, seconds = timed(jax.jit(partial(sampled, found, warmup, count)))
        effective = effective_sample_size(chains)
        values = chains.reshape(-1, chains.shape[-1])
        print(f"\nMeasured to {1e3 * sigma:g} mm: {len(values)} samples, {seconds:.0f} s with compilation")
        for i, (path, value) in enumerate(found.values.items()):
            error, mean, spread = found.stderr[path], float(values[:, i].mean()), float(values[:, i].std())
            low, high = np.quantile(np.asarray(values[:, i]), [0.025, 0.975])
            line(
                path, f"fit      {value:.6g} +- {error:.3g}", "95 % in {:.6g} to {:.6g}".format(*found.interval()[path])
            )
            line("", f"samples  {mean:.6g} +- {spread:.3g}", f"95 % in {low:.6g} to {high:.6g}")
            line("", f"worth {effective[i]:.0f} independent ones", f"mean off by {(mean - value) / error:+.3f} errors")
            if sigma == 5e-5:
                agree += [abs(mean - value) / error < 0.1, abs(spread / error - 1) < 0.1]
        corr = float(jnp.corrcoef(values.T)[0, 1])
        line("correlation", f"fit {found.correlation[0, 1]:.4f}, samples {corr:.4f}")
    return all(agree)


if __name__ == "__main__":
    chosen = options("a tenth of the samples")
    print(CLAIM)
    held = main(100, 100) if chosen.quick else main(300, 1000)
    print(f"\nThe claim {'held' if held else 'DID NOT HOLD'} in this run.")
