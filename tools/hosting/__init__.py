"""Files on other people's servers: whether a host serves scenes well, and uploads to it."""
