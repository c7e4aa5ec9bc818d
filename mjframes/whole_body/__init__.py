"""The body's own stiffness: finite elements on all voxels, condensed to what the frames feel of them."""
