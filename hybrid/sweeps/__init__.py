"""Tables and figures over one quantity at a time, including those of Foveated Path Culling (FPC)."""
