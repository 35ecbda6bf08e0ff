"""A second simulator of the project's measurements, in NumPy and SciPy alone.

It imports nothing of the package beside it, so that agreement between the two means something. The sealed exam draws
its cases with it, and it made the synthetic campaigns in `data/`.
"""
