"""Frozen configurations, loaded from the YAML files in this folder or from a user's own."""

from aerial_gym.config.loader import (
    CONFIG_DIR,
    build,
    dump_yaml,
    family_files,
    load,
    read_summary,
    read_yaml,
    to_mapping,
)

__all__ = ["CONFIG_DIR", "build", "dump_yaml", "family_files", "load", "read_summary", "read_yaml", "to_mapping"]
