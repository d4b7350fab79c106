"""What all commands share: options, values, printed output, progress."""
