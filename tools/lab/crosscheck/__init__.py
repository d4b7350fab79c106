"""Cross-checks: our readers and writers against other people's programs."""
