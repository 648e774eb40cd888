"""Fleet tables as the pages read them: one state, read lazily, until a table has a new version."""

import json
from functools import cached_property
from math import inf, sqrt
from pathlib import Path
from threading import Lock
from typing import Any

from aerial_gym.fleet.page.texts import change_in_scales, change_text
from aerial_gym.fleet.query import connect
from aerial_gym.fleet.tables import FleetTables
from aerial_gym.fleet.wording import cause_name

Row = dict[str, Any]

TEMPLATES = Path(__file__).parent / "templates"


class FleetSnapshot:
    """One version of each table in a database in memory, which reads nothing else."""

    def __init__(self, tables: FleetTables) -> None:
        self.tables, self._lock, self._database = tables, Lock(), connect(tables)
        self._database.execute((TEMPLATES / "views.sql").read_text(encoding="utf-8"))
        for row in self.rows("SELECT vehicle, causes FROM current WHERE rejected"):
            for cause in json.loads(row["causes"])[:1]:
                size = (row["vehicle"], cause_name(cause), change_text(cause, most=1), change_in_scales(cause))
                self._database.execute("INSERT INTO sizes VALUES (?, ?, ?, ?)", size)

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
        names = dict[tuple[str, str, int, int], list[str]]()
        for digest, columns in self.tables.columns_by_digest().items():
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
        self._tables, self._lock, self._versions = FleetTables(out), Lock(), list[int]()

    def snapshot(self) -> FleetSnapshot:
        """Return the present state of the tables."""
        with self._lock:
            if (versions := self._tables.versions()) != self._versions:
                self._snapshot, self._versions = FleetSnapshot(self._tables), versions
            return self._snapshot
