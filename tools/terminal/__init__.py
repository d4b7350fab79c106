"""Options, parsed values, printed output and progress bars that commands share."""
