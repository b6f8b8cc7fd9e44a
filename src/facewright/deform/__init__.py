"""Deformation transfer and example-based facial rigging."""
