"""What people run: films, logs, plots and pictures of scenes and bodies."""
