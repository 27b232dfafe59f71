"""Drawing meshes with gradients: rasterised texels, contours, pictures."""
