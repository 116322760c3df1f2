"""How good frames are where the viewer looks and where not, how fast, and what else could be had for that."""
