"""Command generators: position and motion of a task's target.

``command.py`` says what a generator is, ``catalog.py`` makes one; the other modules hold those that come with the package.
"""
