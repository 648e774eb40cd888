"""Speed of our physics against other simulators, on one machine in one run: ``python -m benchmarks.peers --help``.

``runs.py`` lists the peers, starts one process per measurement and makes the ratios. Each ``peer_*.py`` runs in the interpreter
of its peer and imports nothing of ours but ``timing.py``.
"""
