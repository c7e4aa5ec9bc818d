"""Drawing of fields on voxels: `views` draws the surface in space, `slices` cuts it, `page` puts both on one page."""
