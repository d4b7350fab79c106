"""Hosting on foreign servers: checks of a host, remedies, and uploads to buckets."""
