"""What made the files in ``data/``: the paper's tables, and campaigns of the second simulator.

``python -m tests.independent.make_data`` writes them; the simulator itself is `ddetumble.exam.simulators`.
"""
