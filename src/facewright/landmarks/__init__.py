"""Landmark schemes as data, detectors and contours (FaceWarehouse 3.2)."""
