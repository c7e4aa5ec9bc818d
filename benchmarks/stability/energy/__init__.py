"""Energy that comes from nothing: bodies that nobody tuned, dropped, thrown, squeezed and let go."""
