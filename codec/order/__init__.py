"""Orders of the splats in a file, and the chunks that an order is cut into."""
