"""Logs of a simulation: MCAP files that Foxglove draws and plots, and that `mjframes replay` reads."""
