"""Camera files: COLMAP, nerfstudio's transforms.json, cameras.json of 3DGS training."""
