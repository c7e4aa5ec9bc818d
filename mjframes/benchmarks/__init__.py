"""Error and run time: the bench, the report against finite elements, the check of stability."""
