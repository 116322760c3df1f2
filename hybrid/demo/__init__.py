"""The window: the mouse is the gaze, and the path-traced disc follows it. Only this room uses Qt."""
