"""PLY files of splats."""
