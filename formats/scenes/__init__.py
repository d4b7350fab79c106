"""Foreign scene formats: PLY, SPZ, SOG, glTF, .splat, .ksplat, checkpoints."""
