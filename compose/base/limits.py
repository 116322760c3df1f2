"""Bounds on what files may declare, so that none asks for more memory than a frame can be worth."""

# Of an image: 16 times those of 4K.
MOST_PIXELS = 1 << 27
