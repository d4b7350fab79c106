"""The synthetic test scene."""
