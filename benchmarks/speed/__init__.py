"""How fast: precomputation, steps, many worlds, tasks, beside MuJoCo's flex and the same bodies alone."""
