"""Numerical stability, tried out: `make check` runs bodies through extreme states and tells what became of them."""
