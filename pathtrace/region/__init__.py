"""Where a viewer may be: regions of free space, views to train on and for validation, what views cover."""
