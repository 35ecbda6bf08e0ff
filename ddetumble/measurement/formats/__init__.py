"""Readers of the files that laboratories have, one file a format: each gives the channels that a file holds."""
