"""The encoding profiles: how the rows of one chunk become streams."""
