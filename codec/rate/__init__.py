"""How many bytes each value is worth: costs, steps, pruning, refinement, segment order."""
