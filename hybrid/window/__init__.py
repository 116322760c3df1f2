"""The window: the mouse is the gaze, and the path-traced disc follows it; the loop knows nothing of Qt."""
