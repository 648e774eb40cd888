"""Frozen configurations, loaded from the YAML files in this folder or from a user's own."""

from aerial_gym.config.loader import CONFIG_DIR, build, dump_yaml, files_of, load, read_yaml, summary_in, to_mapping

__all__ = ["CONFIG_DIR", "build", "dump_yaml", "files_of", "load", "read_yaml", "summary_in", "to_mapping"]
