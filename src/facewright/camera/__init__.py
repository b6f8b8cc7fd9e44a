"""Pinhole and weak-perspective cameras."""
