"""Command generators: where a task's target is, and where it goes.

``command.py`` says what a generator is, ``catalog.py`` makes one; the other modules hold those that come with the package.
"""
