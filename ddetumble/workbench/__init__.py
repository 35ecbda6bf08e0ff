"""The workbench: the loop by hand in a browser, every step of it with the Python lines that do the same.

`bench` holds what is known and done, as values, and uses the package's public names alone; `page` draws it (marimo).
"""
