"""Scenes from glTF 2.0 files: a Mitsuba scene with its meshes, and a motion file for what is animated.

Numbers of sections are those of the glTF 2.0 specification (Khronos, ISO/IEC 12113:2022).
"""
