"""Contact force reconstructed from measured depression and pressure."""
