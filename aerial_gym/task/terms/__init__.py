"""Terms of tasks: pure functions of their inputs, by name.

``term.py`` defines terms; the other modules hold those of the package.
"""
