"""Where a viewer may be: regions of free space, the views to train on and to judge by, what views cover."""
