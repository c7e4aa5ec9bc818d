"""Stiffness, mass and laws of regions, sums over their voxels: the paper's method (§4.3, §5)."""
