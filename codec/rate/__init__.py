"""Rate allocation: error costs, quantisation steps, pruning, refinement split, segment order."""
