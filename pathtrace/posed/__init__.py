"""Folders of other people's images with known cameras and times, but without a scene."""
