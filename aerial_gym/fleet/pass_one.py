"""Pass 1 in a worker: the rows of a batch of logs. The result of a log does not depend on its batch."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from math import isfinite, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from aerial_gym.config.console import one_line
from aerial_gym.errors import AerialGymError, DataError
from aerial_gym.fleet.moments import columns_digest, columns_text, pack_moments
from aerial_gym.fleet.schemas import KEY
from aerial_gym.fleet.sources import LogReference, LogStore, hash_of_log
from aerial_gym.fleet.vehicles import Fleet
from aerial_gym.sim2real.json_values import plain

if TYPE_CHECKING:
    from aerial_gym.fleet.tables import Row

PASS_ONE = "aerial_gym.sim2real.flight_evidence.evidence"
"""Module with ``flight_evidences``, ``model_version`` and ``log_airframe``; tests give another one."""

BATCH_ATTEMPTS, LOG_ATTEMPTS = (
    2,
    5,
)  # After which a batch is split, and a log is refused; workers may die for any reason
_ENDS_PROCESS = SimpleNamespace(reason=f"its analysis has ended the process {LOG_ATTEMPTS} times: too little memory?")
_KNOWN = object()  # Result of a log whose content has rows, under this path or another one


@dataclass(frozen=True, kw_only=True)
class PassOneSettings:
    """Inputs of a worker that are the same for all logs."""

    store: LogStore
    fleet: Fleet
    module: str = PASS_ONE
    scratch: Path  # Folder of fetched logs and of begun work
    mapping: str | None = None
    known: AbstractSet[bytes] = frozenset()  # Digests of keys that have rows: such logs are hashed, not analysed

    def make_worker(self) -> "PassOne":
        """Return a worker."""
        return PassOne(self)


@dataclass(frozen=True, kw_only=True)
class LogRows:
    """Rows of one log."""

    flight: "Row"
    evidence: "tuple[Row, ...]" = ()
    columns: str = ""  # JSON
    unread: str = ""  # Reason why the store did not deliver the log: it gets no row, and the next run tries again


@dataclass(frozen=True, kw_only=True)
class _LocalLog:
    """A log that has been fetched."""

    reference: LogReference
    path: Path
    log_hash: str
    airframe: str
    robot: str  # Name; "" without one

    def text(self, content: str) -> str:
        """Return a text in one line, with the log's own path in place of that of its copy."""
        return one_line(content.removeprefix(f"{self.path}: ").replace(str(self.path), self.reference.path))

    def findings_text(self, findings: Iterable[Any]) -> str:
        """Return findings as JSON, with the log's own path in place of that of its copy."""
        content = [{"code": one.code, "subject": one.subject, "values": plain(one.values)} for one in findings]
        copy, own = (json.dumps(str(path), ensure_ascii=False)[1:-1] for path in (self.path, self.reference.path))
        return json.dumps(content, ensure_ascii=False, default=str).replace(copy, own)


class PassOne:
    """Worker that keeps the kernels loaded from batch to batch."""

    def __init__(self, settings: PassOneSettings) -> None:
        self._settings, self._fleet, self._module = settings, settings.fleet, import_module(settings.module)
        self.version: str = self._module.model_version()

    def __call__(self, references: Sequence[LogReference]) -> list[LogRows]:
        """Return the rows of logs, in their order. A log that ends the process again and again is refused."""
        with self._attempt(f"batch_{references[0].rank}") as attempts:
            if attempts <= BATCH_ATTEMPTS:
                return self._batch(references)
            rows = list[LogRows]()
            for reference in references:
                with self._attempt(f"log_{reference.rank}") as attempts:
                    rows += self._batch([reference], refused=attempts > LOG_ATTEMPTS)
            return rows

    @contextmanager
    def _attempt(self, name: str) -> Iterator[int]:
        """Yield how often work was begun and not ended, as its process died."""
        file = self._settings.scratch / f"{name}.begun"
        with file.open("ab") as stream:
            stream.write(b".")
        yield file.stat().st_size
        file.unlink()

    def _batch(self, references: Sequence[LogReference], *, refused: bool = False) -> list[LogRows]:
        from aerial_gym.interop import one_thread

        rows = dict[int, LogRows]()
        with one_thread(), TemporaryDirectory(dir=self._settings.scratch, prefix="aerial_gym_logs_") as folder:
            logs = list[_LocalLog]()
            for reference in references:
                try:
                    logs.append(self._fetch(reference, Path(folder)))
                except Exception as error:  # of any file system's own type
                    rows[reference.rank] = LogRows(flight={"path": reference.path}, unread=str(error) or repr(error))
            known = [log for log in logs if row_digest(self._key(log)) in self._settings.known]
            rows |= {log.reference.rank: self._rows(log, _KNOWN) for log in known}
            for robot in sorted({log.robot for log in logs if log not in known}):
                same = [log for log in logs if log.robot == robot and log not in known]
                results = len(same) * [_ENDS_PROCESS] if refused else self._results(robot, same)
                for log, result in zip(same, results, strict=True):
                    rows[log.reference.rank] = self._rows(log, result)
        return _without_repeated_columns([rows[rank] for rank in sorted(rows)])

    def _fetch(self, reference: LogReference, folder: Path) -> _LocalLog:
        if one_line(reference.path) != reference.path:
            raise DataError("its name has control characters, or bytes that are not UTF-8: rename it")
        path, airframe = self._settings.store.fetch(reference, folder), ""
        digest = hash_of_log(path)
        if self._fleet.robot_needs_airframe(reference.path):
            with suppress(AerialGymError):  # pass 1 states the reason
                airframe = one_line(self._module.log_airframe(path))
        robot = self._fleet.assign(reference.path, airframe)[1]
        return _LocalLog(reference=reference, path=path, log_hash=digest, airframe=airframe, robot=robot)

    def _results(self, robot: str, logs: Sequence[_LocalLog]) -> "Sequence[Any]":
        if not robot:
            return [None] * len(logs)
        paths = [log.path for log in logs]
        return self._module.flight_evidences(self._fleet.robots[robot], paths, mapping=self._settings.mapping)

    def _key(self, log: _LocalLog) -> dict[str, str]:
        robot_hash = self._fleet.hashes.get(log.robot, "")
        return {"log_hash": log.log_hash, "robot_hash": robot_hash, "model_version": self.version}

    def _rows(self, log: _LocalLog, result: Any) -> LogRows:
        """Return the rows of a log: of its evidence, of its refusal (``reason``), or for want of a robot (None)."""
        airframe = one_line(getattr(result, "airframe", "")) or log.airframe
        vehicle, _ = self._fleet.assign(log.reference.path, airframe)
        key = self._key(log)
        flight: dict[str, Any] = key | {
            "path": log.reference.path, "vehicle": vehicle, "firmware": "", "start_time": nan,
            "order": float(log.reference.rank), "duration_s": 0.0, "status": "refused", "reason": "", "checks": "[]",
            "events": "[]", "rows": 0, "square": 0.0, "columns": "", "moments": b"", "airframe": airframe,
            "size": log.reference.size, "modified": log.reference.modified,
        }  # fmt: skip
        if result is None:
            known = ", ".join(self._fleet.robots)
            way = f"give {vehicle}.yaml in --robots (aerial-gym robot from-log drafts one) or a rule in --rules"
            reason = f"no robot file for vehicle {vehicle!r}: {way}. Known robots: {known}"
            return LogRows(flight=flight | {"reason": reason})
        if result is _KNOWN:
            return LogRows(flight=flight | {"status": "known"})
        if hasattr(result, "reason"):
            return LogRows(flight=flight | {"reason": log.text(result.reason)})
        moments = pack_moments(result.product, result.gradient)
        if moments is None:
            return LogRows(flight=flight | {"reason": "its moments are not finite"})
        columns = columns_text(result.columns)
        flight |= {
            "firmware": one_line(result.firmware), "start_time": result.start_time,
            "duration_s": result.duration_s, "status": "ok",
            "checks": log.findings_text(result.checks), "events": log.findings_text(result.events),
            "rows": result.rows, "square": result.square, "columns": columns_digest(columns),
            "moments": moments,
        }  # fmt: skip
        if isfinite(result.start_time):
            flight["order"] = result.start_time
        names = ("effect", "rotor", "start", "params", "cov", "score")
        evidence = (key | {"vehicle": vehicle} | {name: getattr(one, name) for name in names} for one in result.effects)
        return LogRows(flight=flight, evidence=tuple(evidence), columns=columns)


def row_digest(row: "Row", names: Sequence[str] = KEY) -> bytes:
    """Return the digest of some columns of a flight."""
    return hashlib.sha256("\0".join(str(row[name]) for name in names).encode("utf-8", "surrogatepass")).digest()


def _without_repeated_columns(rows: Sequence[LogRows]) -> list[LogRows]:
    """Return rows that state equal columns only once, as they are most of a row that a worker sends."""
    stated, kept = set[str](), []
    for row in rows:
        kept.append(replace(row, columns="") if row.columns in stated else row)
        stated.add(row.columns)
    return kept
