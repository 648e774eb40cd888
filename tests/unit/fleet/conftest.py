"""Tests of the fleet's tables need the packages of the extra ``fleet``."""

from importlib.util import find_spec

if find_spec("deltalake") is None or find_spec("fsspec") is None:
    collect_ignore_glob = ["test_*.py"]
