"""The sealed exam: hidden truths simulated by a second implementation, judged blind by `discover`, and marked."""
