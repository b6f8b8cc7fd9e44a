"""Rotations, similarity, sparse and bounded solves, checks."""
