"""Command-line options, their values, printed output and progress bars."""
