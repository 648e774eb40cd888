"""Evidence of single flights: a pure function of the log, the robot file and the version of the model.

Every choice is that of the flight alone: clock offset and scale of commands, band, channels, tolerances after moves and
gains, effects that it can show, and channel weights. No battery is estimated: effects of the battery need one in the robot
file, or they would mean something else in each flight. Letters: K columns.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

import aerial_gym
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError, MissingDependencyError
from aerial_gym.interop import one_thread
from aerial_gym.physics.model import check_effects
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.failures.flight_event import FailureFinder
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.flight_evidence.columns import EvidenceColumn, candidates_of_columns, evidence_columns
from aerial_gym.sim2real.flight_evidence.moments import FlightSums, sums_of_flights, with_common_tolerances
from aerial_gym.sim2real.flight_evidence.reading import (
    ComparisonSettings,
    LogContent,
    comparison_settings,
    flight_parts,
    predictors_of_group,
    read_log,
)
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, NormalEquations, log_evidences, posterior
from aerial_gym.sim2real.identify.evidence.search import SetPosterior
from aerial_gym.sim2real.logs.flights import Flight, check_bandwidth
from aerial_gym.sim2real.logs.identity import log_identity
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from aerial_gym.sim2real.predict.tolerances import Tolerances

JUDGED_SOURCE = ("physics", "config", "sim2real")  # Folders whose source decides the evidence of a flight


@dataclass(frozen=True, kw_only=True)
class EffectEvidence:
    """Evidence for one effect alone, from one start or on one rotor, with the tolerances integrated out."""

    effect: str
    rotor: int  # Number of the rotor from 1, 0 for an effect on the vehicle
    start: int  # Number of the start from 1, 0 for an effect with one start
    params: tuple[float, ...]  # Most probable values of the continuous parameters, in physical units
    cov: tuple[float, ...]  # Their covariance, row by row
    score: float  # Log posterior odds of this effect alone over none, prior cost included


@dataclass(frozen=True, kw_only=True)
class FlightEvidence:
    """Evidence of one log; ``product``, ``gradient``, ``square`` and ``rows`` of several logs add."""

    columns: tuple[EvidenceColumn, ...]
    product: Array  # Information matrix ``sum w J J^T``, (K, K)
    gradient: Array  # ``sum w J r``, (K,)
    square: float  # ``sum w r^2``
    rows: int  # Number of compared rows
    effects: tuple[EffectEvidence, ...]  # Of each effect that the log can show
    checks: tuple[Finding, ...]  # Notes on the log
    events: tuple[Finding, ...]  # Suspected failures
    duration_s: float
    airframe: str  # Identity of the vehicle; empty if the log does not state it
    firmware: str  # Version of the firmware; empty if the log does not state it
    start_time: float  # Unix time of the start [s]; NaN if the log does not state it


@dataclass(frozen=True, kw_only=True)
class RefusedFlight:
    """A log that cannot be compared."""

    reason: str


def flight_evidences(
    robot: RobotCfg, logs: Sequence[str | Path], *, mapping: str | Path | LogMapping | None = None,
    bandwidth: float = 10.0, tolerances: Tolerances | None = None,
) -> list[FlightEvidence | RefusedFlight]:  # fmt: skip
    """Return the evidence of each log, or the reason against it; neither depends on its path or on the other logs.

    Flights of the same kind share predictions, so several logs in one call are faster than one by one.

    Args:
        robot: The declared robot.
        logs: Log files of any known format; ``FILE#2`` selects the second flight of one.
        mapping: Name or file of a log mapping, or the mapping; None for the layouts of the formats themselves.
        bandwidth: Bandwidth of the comparison [Hz], which a slow log lowers for itself.
        tolerances: Standard deviations of the declared values.

    Raises:
        ConfigError, UnknownNameError: If robot, mapping or bandwidth is invalid.
    """
    check_bandwidth(bandwidth)
    check_effects(robot)
    layout = find_mapping(mapping) if isinstance(mapping, str | Path) else mapping
    with one_thread():
        batch = _Batch(robot, tolerances or Tolerances(), bandwidth)
        for place, log in enumerate(logs):
            batch.add_log(place, log, layout)
        batch.compare()
        return [batch.result(place) for place in range(len(logs))]


_Part = tuple[int, int, Flight]  # Place of the log, number and content of a flight of it or a part of one


class _Batch:
    """Logs of one robot whose flights are compared together."""

    def __init__(self, robot: RobotCfg, tolerances: Tolerances, bandwidth: float) -> None:
        self._robot, self._tolerances, self._bandwidth = robot, tolerances, bandwidth
        self._columns = evidence_columns(robot, tolerances)
        self._candidates = candidates_of_columns(self._columns)
        self._finder = FailureFinder(robot, tolerances=tolerances)
        self._contents, self._reasons = dict[int, LogContent](), dict[int, str]()
        self._events, self._logs = dict[int, tuple[Finding, ...]](), dict[int, str]()
        self._groups = dict[ComparisonSettings, list[_Part]]()
        self._sums = dict[int, dict[int, FlightSums]]()

    def add_log(self, place: int, log: str | Path, mapping: LogMapping | None) -> None:
        """Read a log and put its flights into groups."""
        self._logs[place] = str(log)
        try:
            content = read_log(log, self._robot, mapping, self._bandwidth)
            parts = [part for flight in content.flights for part in flight_parts(flight)]
            settings = [comparison_settings(part, self._bandwidth, self._tolerances) for part in parts]
            failures = [self._finder.find_first_failure(flight) for flight in content.flights]
        except Exception as error:  # a damaged file can fail anywhere in a reader
            self._refuse(place, error)
            return
        left_out = [
            replace(one, values={"error": self._without_path(place, one.values["error"])}) for one in content.left_out
        ]
        self._contents[place], self._sums[place] = replace(content, left_out=tuple(left_out)), {}
        self._events[place] = tuple(replace(one.finding, subject="") for one in failures if one is not None)
        for number, (part, own) in enumerate(zip(parts, settings, strict=True)):
            self._groups.setdefault(own, []).append((place, number, part))

    def _refuse(self, place: int, error: Exception) -> None:
        """Keep the reason against a log; raise what is no fault of the log."""
        if isinstance(error, MissingDependencyError):
            raise error
        text = str(error) if isinstance(error, DataError) else f"cannot be read ({type(error).__name__}: {error})"
        self._reasons.setdefault(place, self._without_path(place, text))

    def _without_path(self, place: int, text: str) -> str:
        return text.removeprefix(f"{self._logs[place]}: ").replace(self._logs[place], "the log")

    def compare(self) -> None:
        """Compute the sums of all flights, group by group."""
        for settings, parts in self._groups.items():
            self._compare_parts(parts, settings)

    def _compare_parts(self, parts: Sequence[_Part], settings: ComparisonSettings) -> None:
        """Compute the sums of flights with the same settings; one by one if that fails, to find the faulty one."""
        effects = slice(0, len(self._columns) - self._candidates.tolerances.size)
        bounds = self._candidates.low[effects], self._candidates.high[effects]
        own, common = (
            one.standard_deviations(self._robot.num_rotors) for one in (settings.tolerances, self._tolerances)
        )
        try:
            predictors = predictors_of_group(self._robot, [flight for *_, flight in parts], settings)
            sums = [
                with_common_tolerances(one, own, common) for each in predictors for one in sums_of_flights(each, bounds)
            ]
        except Exception as error:
            for part in parts if len(parts) > 1 else ():
                self._compare_parts([part], settings)
            if len(parts) == 1:
                self._refuse(parts[0][0], error)
            return
        for (place, number, _), one in zip(parts, sums, strict=True):
            self._sums[place][number] = one

    def result(self, place: int) -> FlightEvidence | RefusedFlight:
        """Return the evidence of a log, or the reason against it."""
        if place in self._reasons:
            return RefusedFlight(reason=self._reasons[place])
        content, (first, *more) = self._contents[place], (one for _, one in sorted(self._sums[place].items()))
        sums, identity = sum(more, first), content.flights[0].identity
        notes = dict.fromkeys(note for flight in content.flights for note in flight.notes)
        return FlightEvidence(
            columns=self._columns,
            **vars(sums),
            effects=evidence_of_effects(self._columns, self._candidates, sums),
            checks=(*notes, *content.left_out),
            events=self._events[place],
            duration_s=sum(float(flight.time[-1]) for flight in content.flights),
            airframe=identity.airframe,
            firmware=identity.firmware,
            start_time=np.nan if identity.start_time is None else identity.start_time,
        )


def evidence_of_effects(
    columns: Sequence[EvidenceColumn], candidates: Candidates, sums: FlightSums
) -> tuple[EffectEvidence, ...]:
    """Return the evidence for each effect alone that the sums show."""
    normal = NormalEquations(product=sums.product, gradient=sums.gradient).marginal(candidates.tolerances)
    alone, shown = candidates.without_tolerances(), np.diag(sums.product) > 0.0
    single = [(k,) for k, places in enumerate(candidates.columns) if shown[places].any()]
    cost = SetPosterior(candidates=alone, normal=normal).log_prior_cost_of_effect
    none, *logs = log_evidences(alone, normal, [(), *single]).tolist()
    results = []
    for (k,), log in zip(single, logs, strict=True):
        best, own = posterior(alone, normal, (k,)), [columns[place] for place in candidates.columns[k]]
        scale, neutral = (np.array([getattr(one, name) for one in own]) for name in ("scale", "neutral"))
        owner = {"effect": own[0].effect, "rotor": own[0].rotor, "start": own[0].start}
        params = tuple((neutral + scale * best.step).tolist())
        cov = tuple((np.outer(scale, scale) * best.covariance).ravel().tolist())
        results.append(EffectEvidence(**owner, params=params, cov=cov, score=log - none - cost))
    return tuple(results)


def log_airframe(log: str | Path) -> str:
    """Return the identity of the vehicle that a log states; empty if it states none."""
    raw = read_raw_log(Path(log))
    return "" if raw is None else log_identity(raw, 0.0).airframe


@cache
def model_version() -> str:
    """Return the package version and 12 hexadecimal digits of a hash over the source that decides the evidence."""
    root, digest = Path(aerial_gym.__file__).parent, hashlib.sha256()
    for path in sorted(path for folder in JUDGED_SOURCE for path in (root / folder).rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        number = version("aerial_gym")
    except PackageNotFoundError:
        number = "0"
    return f"{number}+{digest.hexdigest()[:12]}"
