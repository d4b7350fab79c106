"""Training: differentiable rendering, optimiser, losses, pruning, previews and levels."""
