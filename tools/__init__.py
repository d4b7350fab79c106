"""What people run: the command line, the bench and the vector maker."""
