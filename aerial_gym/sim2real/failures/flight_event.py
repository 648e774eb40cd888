"""Events in single flights: failures and sensor faults with name, size and onset, each with its interval.

Rows after a failure are not compared with the intact vehicle. Letters: T rows, K blocks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import hypot

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import hover_speed, rotor_thrust, state_for_thrust
from aerial_gym.sim2real.failures.rotor_work import BLOCK_S, RotorOutput, RotorOutputModel
from aerial_gym.sim2real.failures.scan import (
    FailureCause,
    FailureTiming,
    locate_onset,
    log_sum_of_odds,
    rank_failure_causes,
)
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import take_rows
from aerial_gym.sim2real.logs.rotor_model import place_of_rotor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.statistics import FALSE_ALARM_HOURS

WINDOW_BLOCKS = 600  # Number of blocks analysed together: one minute
SHORTEST_S = 2.0  # Least time before a failure that leaves a usable flight [s]

SHORTEST_BROWN_OUT_S = (
    2.0 * BLOCK_S
)  # Within a shorter one, no block shows the lag of the rotors, which a contact lacks


@dataclass(frozen=True, kw_only=True)
class FlightEvent:
    """An event in one flight, with its onset."""

    flight: str
    name: str  # motor_failure, weak_motor, stuck_rotor or brown_out; position_jump or sensor_dropout
    params: dict[str, float]
    """As in robot files. ``time`` is from the first row [s]; ``speed`` is the constant speed of a stuck rotor [rad/s], or its
    thrust [N]; ``x``, ``y``, ``z`` are a position jump [m], world."""

    std: dict[str, float] = field(default_factory=dict)  # Standard deviations of the numeric parameters
    interval: dict[str, tuple[float, float]] = field(default_factory=dict)  # 95 % intervals

    @property
    def time(self) -> float:
        """Return the onset from the first row of the log [s]."""
        return self.params["time"]


@dataclass(frozen=True, kw_only=True)
class Failure(FlightEvent):
    """A failure of a rotor or of the supply in one flight."""

    log_odds: float  # Log odds of this failure against none, at its onset
    probability: float  # Probability of this failure and rotor among all known ones
    rival: str  # Most probable other failure; empty without one
    place: str = ""  # Place of the rotor, such as ``front left``; empty for all rotors or a place that is not unique
    unit: str = "rad_s"  # Unit of a stuck rotor's state: rad_s, or n in force mode

    @property
    def finding(self) -> Finding:
        """Return the failure with its numbers as a finding."""
        values: dict[str, object] = {"failure": self.name, "time_s": self.time}
        values |= dict(zip(("time_low_s", "time_high_s"), self.interval["time"], strict=True))
        if "motor" in self.params:
            values |= {"rotor": round(self.params["motor"]), "place": self.place}
        if "scale" in self.params:
            values |= {"share": self.params["scale"]}
            values |= dict(zip(("share_low", "share_high"), self.interval["scale"], strict=True))
        if "speed" in self.params:
            values[f"state_{self.unit}"] = self.params["speed"]
        if "duration" in self.params:
            values["duration_s"] = self.params["duration"]
        return Finding("failure_found", self.flight, values)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        told = select_fields(self, "flight", "name", "params", "std", "interval", "log_odds", "probability")
        return {**told, "rival": self.rival or None, "sentence": self.finding}


def least_log_odds(false_alarm_hours: float) -> float:
    """Return the log of the least sum of odds (``log_sum_of_odds``) that counts as a failure.

    Without a failure the sum grows by 1 per block on average, so the limit is at most the mean number of blocks between
    alarms. Source: Pollak (1985), Optimal detection of a change in distribution, Annals of Statistics 13
    (Shiryaev-Roberts).
    """
    return float(np.log(false_alarm_hours * 3600.0 / BLOCK_S))


class FailureFinder:
    """Finds failures in flights of a declared robot."""

    def __init__(
        self, robot: RobotCfg, *, tolerances: Tolerances | None = None, false_alarm_hours: float = FALSE_ALARM_HOURS
    ) -> None:
        if not 0.0 < false_alarm_hours < np.inf:
            raise ConfigError(f"false_alarm_hours = {false_alarm_hours!r}: must be > 0 and finite")
        self.works, self.limit = RotorOutputModel(robot), least_log_odds(false_alarm_hours)
        self._robot, self.tolerances = robot, tolerances or Tolerances()
        self._vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        self._hover = hover_speed(self._vehicle, STANDARD_GRAVITY)

    def find_first_failure(self, flight: Flight) -> Failure | None:
        """Return the first failure of a flight, or None; windows of a minute overlap by half."""
        works = self.works.outputs_of_flight(flight)
        count = max((work.time.size for work in works), default=0)
        for begin in range(0, max(count - WINDOW_BLOCKS // 2, 1), WINDOW_BLOCKS // 2):
            failure = self.find_in_blocks(
                [work.select_blocks(slice(begin, begin + WINDOW_BLOCKS)) for work in works], flight.name
            )
            if failure is not None:
                return failure
        return None

    def find_in_blocks(self, works: Sequence[RotorOutput], flight: str) -> Failure | None:
        """Return the failure that the blocks show; None if its log odds are no larger than usual, or if it is immaterial.

        Errors of the declared vehicle or of the log look like failures all the time, with log odds that grow with time. So the
        log sum of odds must exceed the limit plus that before the onset. A failure is immaterial if its interval excludes a
        loss of 5 %.
        """
        causes = rank_failure_causes(works, self.tolerances)
        if not (odds := log_sum_of_odds(causes)) > self.limit:
            return None
        ranked = sorted((locate_onset(one) for one in causes if one.log_odds > 0.0), key=lambda one: -one.log_odds)
        first = ranked[0]
        if first.end is not None and first.end - first.time < SHORTEST_BROWN_OUT_S:
            return None
        if not odds > self.limit + self._usual_odds(works, first):
            return None
        logs = np.array([one.log_odds for one in ranked])
        probability = float(1.0 / np.exp(logs - logs[0]).sum())
        rival = ranked[1].cause if len(ranked) > 1 else None
        failure = self._make_failure(first, flight, probability, rival)
        material = "scale" not in failure.interval or failure.interval["scale"][0] < 1.0 - Criteria().material
        return failure if material else None

    def _usual_odds(self, works: Sequence[RotorOutput], event: FailureTiming) -> float:
        """Return the log sum of odds before an onset, for as long as the failure lasts; infinite if too little comes before."""
        onset, blocks = event.interval[0], np.concatenate([work.time for work in works])
        before = [work.select_blocks(work.time + work.length < onset) for work in works]
        causes = rank_failure_causes(before, self.tolerances)
        usual = log_sum_of_odds(causes)
        if not any(np.isfinite(one.log_odds) for one in causes if one.work.quantity == event.cause.work.quantity):
            return np.inf
        last = float(blocks.max()) if event.end is None else event.end
        return max(usual, 0.0) * max(1.0, (last - onset) / (onset - float(blocks.min())))

    def _make_failure(
        self, event: FailureTiming, flight: str, probability: float, rival: FailureCause | None
    ) -> Failure:
        """Return the failure with the parameters of its effect."""
        cause, work = event.cause, event.cause.work
        params, std, interval = dict[str, float](), dict[str, float](), dict[str, tuple[float, float]]()
        if cause.rotor is not None:
            params["motor"] = float(cause.rotor + 1)
        if cause.kind == "stuck_rotor":
            values = [self._speed_of_stuck_rotor(cause, event.change + step * event.std) for step in (0.0, -1.96, 1.96)]
            name = "speed"
        else:
            off = event.std
            if work.quantity == "thrust":  # the change is relative to declared thrust
                off = hypot(off, event.change * self.tolerances.thrust, event.change * self.tolerances.mass)
            values = [self._share_of_command(cause, 1.0 + event.change + step * off) for step in (0.0, -1.96, 1.96)]
            name = "scale"
        params[name], interval[name], std[name] = values[0], (values[1], values[2]), (values[2] - values[1]) / 3.92
        late = 1.96 * work.lag * self.tolerances.time_constant
        params["time"], interval["time"] = event.time, (event.interval[0] - late, event.interval[1] + late)
        std["time"] = (interval["time"][1] - interval["time"][0]) / 3.92
        if event.end is not None:
            params["duration"] = event.end - event.time
        return Failure(
            flight=flight,
            name=cause.kind,
            params=params,
            std=std,
            interval=interval,
            log_odds=event.log_odds,
            probability=probability,
            rival="" if rival is None else rival.name,
            place="" if cause.rotor is None else place_of_rotor(self._robot, cause.rotor + 1),
            unit="n" if "force" in self._robot.rotor_traits else "rad_s",
        )

    def _share_of_command(self, cause: FailureCause, done: float) -> float:
        """Return the remaining share of the command; a share of thrust is converted by the thrust map."""
        if cause.kind == "weak_motor" or cause.work.quantity == "speed":
            return max(done, 0.0)
        hover = self._hover[None]
        state = state_for_thrust(self._vehicle, max(done, 0.0) * rotor_thrust(self._vehicle, hover))
        return float((state / hover).mean())

    def _speed_of_stuck_rotor(self, cause: FailureCause, done: float) -> float:
        """Return the state of a rotor with a given output relative to hover."""
        assert cause.rotor is not None
        hover = self._hover[None]
        if cause.work.quantity == "speed":
            return done * float(self._hover[cause.rotor])
        state = state_for_thrust(self._vehicle, max(done, 0.0) * rotor_thrust(self._vehicle, hover))
        return float(state[0, cause.rotor])


def cut_at_failures(flights: Sequence[Flight], failures: Sequence[Failure]) -> list[Flight]:
    """Return the flights up to their failures, without those that are too short before them."""
    onset = {failure.flight: failure.interval["time"][0] for failure in failures}
    parts = []
    for flight in flights:
        if flight.name not in onset:
            parts.append(flight)
        elif onset[flight.name] >= SHORTEST_S:
            parts.append(take_rows(flight, slice(0, int(onset[flight.name] * flight.rate))))
    return parts


def failure_of_all_flights(failures: Sequence[Failure], flights: int) -> Failure | None:
    """Return the failure common to so many flights, of one rotor, size and time within intervals, by means; else None."""
    if len(failures) < flights or len({(f.name, f.params.get("motor")) for f in failures}) != 1:
        return None
    first = failures[0]
    for name in first.interval:
        low, high = (np.array([f.interval[name][end] for f in failures]) for end in (0, 1))
        if low.max() > high.min():
            return None
    mean = {name: float(np.mean([f.params[name] for f in failures])) for name in first.params}
    spread = {name: float(np.mean([f.std[name] for f in failures])) / flights**0.5 for name in first.std}
    within = {name: (mean[name] - 1.96 * one, mean[name] + 1.96 * one) for name, one in spread.items()}
    return replace(first, params=mean, std=spread, interval=within)
