"""Measurements behind design decisions, one module per bench; docs/measured.md has the results."""
