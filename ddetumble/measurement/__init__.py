"""What was done on the bench and what was read: campaigns in SI units, from data packages and raw files."""
