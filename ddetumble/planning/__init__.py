"""What to do next: the test that tells rivals apart, what a planned campaign could see."""
