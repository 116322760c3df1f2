"""Measurements behind design decisions, one module per bench; docs/measured has the results."""
