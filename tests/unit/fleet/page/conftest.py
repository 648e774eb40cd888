"""Tests of the pages need two packages of the extra ``fleet``."""

from importlib.util import find_spec

if find_spec("deltalake") is None or find_spec("duckdb") is None:
    collect_ignore_glob = ["test_*.py"]
else:
    from tests.unit.fleet.page.servers import client, fleet, open_tables  # noqa: F401
