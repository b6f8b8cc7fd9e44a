"""Finding photographs, scans and videos in the model (FaceWarehouse 3.2, 4)."""
