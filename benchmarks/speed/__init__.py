"""Cost of starts, memory layouts and options."""
