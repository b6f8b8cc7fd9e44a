"""From meshes back to pixels: rasteriser and shading."""
