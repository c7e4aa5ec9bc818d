"""What is seen and what touches: isosurface, skins, contact vertices, the signed distance at rest (the paper, §5.4)."""
