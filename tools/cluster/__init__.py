"""Executors of the encoder on processes and machines, instead of the threads of `codec`."""
