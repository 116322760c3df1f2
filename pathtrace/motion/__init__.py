"""What moves in a scene, as a function of time: read from a file, without a renderer."""
