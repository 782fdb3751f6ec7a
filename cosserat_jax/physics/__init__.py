"""Floor 2, physics: pure functions and small modules. Section law, muscles, water, weight, the rod's equations."""
