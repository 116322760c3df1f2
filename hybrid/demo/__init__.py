"""The window: the mouse is the gaze, and the frame follows it."""
