"""glTF and GLB files with KHR_gaussian_splatting."""
