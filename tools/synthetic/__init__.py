"""The synthetic test scene: shapes, materials, lighting, cameras, labels, masks."""
