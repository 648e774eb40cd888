"""Computations of a task step, one kernel each: command, rewards and ends, buffers, observation.

``by_row.py`` makes a kernel of pure functions of named tensors, ``judge.py`` and ``observe.py`` say which functions,
``act.py`` converts actions, ``step_graph.py`` holds a whole step; ``traced.py`` gives the same functions gradients.
"""
