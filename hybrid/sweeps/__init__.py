"""Tables and figures over one quantity at a time, those of Foveated Path Culling (FPC) among them."""
