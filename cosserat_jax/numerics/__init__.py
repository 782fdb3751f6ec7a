"""Floor 0, numerics: batches, small linear systems, roots, derivatives and integrators that know no rod."""
