"""SQL queries of the fleet's tables by DuckDB: one statement that reads, with access to nothing but the tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.schemas import SCHEMAS
from aerial_gym.fleet.tables import FleetTables

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


def connect(tables: FleetTables) -> "DuckDBPyConnection":
    """Return a database in memory with the tables by name; its access to files and networks is off for good."""
    import duckdb

    database = duckdb.connect(":memory:")
    for name in SCHEMAS:
        database.register(name, tables.dataset(name))
    database.execute("SET python_enable_replacements = false; SET enable_external_access = false")
    database.execute("SET lock_configuration = true")
    return database


def query(out: Path, sql: str) -> tuple[list[str], Iterator[tuple[Any, ...]]]:
    """Return the names of the columns and the rows of one statement; raise ``ConfigError`` for any that does not only read."""
    import duckdb

    with_tables = connect(FleetTables(out))
    try:
        statements = with_tables.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
            raise ConfigError("the query must be one SELECT, WITH or DESCRIBE: the tables are only read here")
        result = with_tables.execute(statements[0])
    except duckdb.Error as error:
        raise ConfigError(f"the query fails: {error}") from None
    names = [column[0] for column in result.description or ()]
    return names, iter(result.fetchone, None)  # type: ignore[arg-type]
