"""Measures every figure that the documentation states, and writes its tables."""
