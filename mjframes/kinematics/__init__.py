"""How the material follows the frames: control points, gradients, the order of elimination (the paper, §3)."""
