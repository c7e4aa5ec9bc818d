"""The linear elasticity of a whole body on its voxels: many loads at once, by multigrid and conjugate gradients."""
