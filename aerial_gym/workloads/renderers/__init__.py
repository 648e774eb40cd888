"""Other renderers for comparison: ``aerial-gym bench render --against``.

``runs.py`` lists them, starts a process for each and compares its images with ours. ``worker.py``, ``mujoco_scene.py`` and
each ``peer_*.py`` run in the interpreter of a peer and import nothing of ours.
"""
