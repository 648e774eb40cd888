"""Fleet tables as the pages read them: one state, read lazily, until a table has a new version."""

import json
from functools import cached_property
from math import inf, sqrt
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from aerial_gym.errors import ConfigError
from aerial_gym.extras import optional_import
from aerial_gym.fleet.page.texts import cause_name, change_in_scales, change_text

if TYPE_CHECKING:
    from deltalake import DeltaTable

Row = dict[str, Any]

TABLES = ("flights", "evidence", "vehicles", "verdicts")
TEMPLATES = Path(__file__).parent / "templates"


class FleetSnapshot:
    """One version of each table in a database in memory, which reads nothing else."""

    def __init__(self, out: Path, tables: "dict[str, DeltaTable]") -> None:
        with optional_import("fleet view"):
            import duckdb

            from aerial_gym.fleet.tables import delta_dataset

        self.out, self._lock, self._database = out, Lock(), duckdb.connect(":memory:")
        for name, table in tables.items():
            self._database.register(name, delta_dataset(table, out / name))
        self._database.execute("SET python_enable_replacements = false; SET enable_external_access = false")
        self._database.execute((TEMPLATES / "views.sql").read_text(encoding="utf-8"))
        for row in self.rows("SELECT vehicle, causes FROM current WHERE rejected"):
            for cause in json.loads(row["causes"])[:1]:
                size = (row["vehicle"], cause_name(cause), change_text(cause, most=1), change_in_scales(cause))
                self._database.execute("INSERT INTO sizes VALUES (?, ?, ?, ?)", size)
        self._database.execute("SET lock_configuration = true")

    def rows(self, sql: str, *values: object) -> list[Row]:
        """Return the rows of a query; texts of logs and requests come in as parameters only."""
        with self._lock:
            result = self._database.execute(sql, list(values))
            names = [column[0] for column in result.description or ()]
            return [dict(zip(names, row, strict=True)) for row in result.fetchall()]

    def row(self, sql: str, *values: object) -> Row | None:
        """Return the first row of a query, or None."""
        return next(iter(self.rows(sql, *values)), None)

    @cached_property
    def _names(self) -> dict[tuple[str, str, int, int], list[str]]:
        """Return the parameters of each digest of columns, effect, rotor and start."""
        file, names = self.out / "columns.json", dict[tuple[str, str, int, int], list[str]]()
        for digest, columns in (json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}).items():
            for one in columns:
                names.setdefault((digest, one["effect"], one["rotor"], one["start"]), []).append(one["parameter"])
        return names

    def parameters(self, evidence: Row, digest: str) -> list[Row]:
        """Return name, value and standard deviation of each parameter in a row of ``evidence``."""
        values, cov, size = evidence["params"], evidence["cov"], len(evidence["params"])
        names = self._names.get((digest, evidence["effect"], evidence["rotor"], evidence["start"]), [])
        names = names if len(names) == size else [f"parameter {k + 1}" for k in range(size)]
        stds = [sqrt(one) if one >= 0.0 else inf for one in (cov[:: size + 1] if len(cov) == size**2 else [inf] * size)]
        return [{"name": n, "value": v, "std": s} for n, v, s in zip(names, values, stds, strict=True)]


class FleetStore:
    """Folder of tables, and the snapshot of their present versions."""

    def __init__(self, out: Path) -> None:
        """Raise ``ConfigError`` if the folder holds no tables of a fleet."""
        with optional_import("fleet view"):
            from deltalake import DeltaTable

        if not (out / "fleet.json").is_file():
            raise ConfigError(f"{out}: holds no fleet tables. Make them with: aerial-gym fleet run --out {out}")
        self.out, self._lock, self._versions = out, Lock(), [-1]
        self._tables = {name: DeltaTable(out / name) for name in TABLES}

    def snapshot(self) -> FleetSnapshot:
        """Return the present state of the tables."""
        with self._lock:
            for table in self._tables.values():
                table.update_incremental()
            versions = [table.version() for table in self._tables.values()]
            if versions != self._versions:
                self._snapshot, self._versions = FleetSnapshot(self.out, self._tables), versions
            return self._snapshot
