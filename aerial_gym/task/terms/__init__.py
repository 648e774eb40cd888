"""What a task is made of: pure functions of what they read, by name.

``term.py`` says what a term is; the other modules hold those that come with the package.
"""
