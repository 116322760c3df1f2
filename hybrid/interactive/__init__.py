"""The interactive loop, free of Qt: from the gaze to the image that the window shows."""
