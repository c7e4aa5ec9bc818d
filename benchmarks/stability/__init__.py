"""What goes wrong: extreme states, energy from nothing, random edits of scenes, damaged files."""
