"""Terms of tasks: pure functions of their inputs, by name.

``term.py`` says what a term is; the other modules hold those that come with the package.
"""
