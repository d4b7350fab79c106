"""Commands of ``cogsplat lab``, one a file."""
