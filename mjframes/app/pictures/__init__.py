"""Drawing of fields on voxels: `surface` draws it in space, `slices` cuts it, `page` puts both on one page."""
