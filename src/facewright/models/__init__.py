"""Linear face models: morphable (PCA), blendshapes, bilinear (FaceWarehouse 3.3)."""
