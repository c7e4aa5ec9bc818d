"""The frames' weights at the voxels: Voronoi kernels, potentials, hats (the paper, §4.2 and §4.3)."""
