"""glTF with KHR_gaussian_splatting."""
