"""A second simulator of the project's measurements, in NumPy and SciPy alone.

It shares no line with the package under test, so that agreement between the two means something. It
also makes the synthetic campaigns in ``data/`` (``python -m tests.independent.make_data``).
"""
