"""Work on other processes and other machines: executors beside the threads of `codec`."""
