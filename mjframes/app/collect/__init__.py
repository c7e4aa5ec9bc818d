"""Many worlds of one scene, each with its own materials, start and pushes, kept as shards of MCAP and one table."""
