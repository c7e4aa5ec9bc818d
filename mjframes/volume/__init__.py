"""Labelled volumes of materials, from arrays, images and meshes, and the grid of their voxels (the paper, §4.1)."""
