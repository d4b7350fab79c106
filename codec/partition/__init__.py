"""Cells: the scene's space cut into boxes that a client can fetch one by one."""
