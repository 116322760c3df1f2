"""A server that holds the scene decides what a client draws, after perceptually guided 3DGS (section 3.4)."""
