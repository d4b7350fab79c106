"""Training: pictures whose error reaches every stored value of the splats, and what descends it."""
