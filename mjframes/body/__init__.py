"""Algorithm 1: the stages put together to a soft body, and its file."""
