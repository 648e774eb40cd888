"""Robots under their controllers: every flight of the tables, tuned vehicles."""
