"""What is seen and what touches: isosurface, skins, contact spheres, the signed distance at rest (the paper, §5.4)."""
