"""The command ``aerial-gym``."""
