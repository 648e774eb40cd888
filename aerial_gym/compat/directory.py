"""Folder of the package."""

from pathlib import Path

AERIAL_GYM_DIRECTORY = str(Path(__file__).resolve().parents[2])
"""Folder that holds ``aerial_gym/``, as scripts build paths from it. That simulator's ``resources/`` are not there: robots and
obstacles are YAML files in ``aerial_gym/config/``."""
