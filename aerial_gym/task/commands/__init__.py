"""Command generators: position and motion of a task's target.

``command.py`` defines generators, ``catalog.py`` makes one; the other modules hold those of the package.
"""
