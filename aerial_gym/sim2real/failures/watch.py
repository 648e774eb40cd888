"""Detection of failures during a flight, from the rows of its log as they arrive.

Rows become blocks in a sliding window, searched every half second. Letters: T rows, K blocks.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.failures.flight_event import Failure, FailureFinder, FlightEvent
from aerial_gym.sim2real.failures.rotor_work import BLOCK_S, RotorOutput
from aerial_gym.sim2real.failures.vehicle_fit import FIRST_S, VehicleMisfit, find_misfit
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.flights import Flight, complete_flight
from aerial_gym.sim2real.logs.on_ground import IDLE
from aerial_gym.sim2real.logs.position_jumps import (
    HALF_S,
    PositionJump,
    PositionOffset,
    displacement_from_velocity,
    largest_jump,
)
from aerial_gym.sim2real.logs.readers.mapping import COLUMNS
from aerial_gym.sim2real.logs.readers.stamps import LiveStamps
from aerial_gym.sim2real.logs.recording import LONGEST_GAP_S, NORM_OFF, FlightLog, take_rows
from aerial_gym.sim2real.logs.rotor_model import total_rotor_force
from aerial_gym.sim2real.logs.row_grid import SLOWEST_COMMANDS_HZ
from aerial_gym.sim2real.logs.sample_repeats import (
    LONGEST_FROZEN_S,
    find_frozen_sensors,
    mend_repeated_samples,
    rows_of_last_change,
)
from aerial_gym.sim2real.logs.signals import log_at_equal_steps
from aerial_gym.sim2real.statistics import FALSE_ALARM_HOURS

WINDOW_S = 20.0  # Analysed time span [s], long enough to estimate the scatter of position differences


@dataclass(frozen=True, kw_only=True)
class SensorFault(FlightEvent):
    """A position jump, or a sensor without new values."""

    sensor: str  # Field of ``FlightLog``

    @property
    def finding(self) -> Finding:
        """Return the fault with its numbers as a finding."""
        if self.name == "sensor_dropout":
            return Finding("sensor_dropout", self.flight, {"sensor": self.sensor, "time_s": self.time})
        size = {"size_m": [self.params[a] for a in "xyz"], "half_width_m": [1.96 * self.std[a] for a in "xyz"]}
        size |= {"start_s": self.time, "end_s": self.time, "moved_back": False}
        return Finding("position_jump", self.flight, size)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return select_fields(self, "flight", "name", "sensor", "params", "std", "interval") | {"sentence": self.finding}


class SensorWatch:
    """Monitors the last seconds of one flight; each fault is reported once."""

    def __init__(self, flight: str) -> None:
        self._flight = flight
        self._since = -np.inf  # Start of the compared positions [s], after the last sensor dropout
        self._stopped: dict[str, float] = {}  # Time of the last change of each stopped sensor [s]
        self._jumps: list[tuple[float, PositionJump]] = []
        self._offset = PositionOffset()  # Sum of all jumps, earlier ones included

    @property
    def has_stopped_sensor(self) -> bool:
        """Return whether any sensor has stopped."""
        return bool(self._stopped)

    def find_new_faults(self, log: FlightLog) -> list[SensorFault]:
        """Return the new faults in the last rows of a flight; ``log.time`` is from its first row [s]."""
        return [*self._find_dropouts(log), *self._find_jumps(log)]

    def _find_dropouts(self, log: FlightLog) -> Iterator[SensorFault]:
        """Yield newly stopped sensors; those with new values are monitored again."""
        last = take_rows(log, log.time >= float(log.time[-1]) - 4.0 * LONGEST_FROZEN_S)
        frozen = {one.name for one in find_frozen_sensors(last) if last.time[one.row] + one.seconds >= last.time[-1]}
        stopped = dict[str, float]()
        for name, row in rows_of_last_change(log).items():
            at = float(log.time[row])
            # A stopped sensor stays so until its value changes, even if the vehicle stands for a moment.
            if name in frozen or (name in self._stopped and (row == 0 or at <= self._stopped[name])):
                stopped[name] = at
        for name in stopped.keys() - self._stopped.keys():
            yield SensorFault(flight=self._flight, name="sensor_dropout", sensor=name, params={"time": stopped[name]})
        if self._stopped or stopped:
            self._since = float(log.time[-1])
        self._stopped = {name: self._stopped.get(name, at) for name, at in stopped.items()}

    def _find_jumps(self, log: FlightLog) -> Iterator[SensorFault]:
        """Yield a new jump once all rows for its comparison are there."""
        log = take_rows(log, log.time >= self._since)
        if log.position is None or log.lin_vel is None or log.time.size < 2:
            return
        try:
            log = log_at_equal_steps(mend_repeated_samples(log))
        except DataError:  # missing rows, or a sensor dropout in this span
            return
        assert log.position is not None
        assert log.lin_vel is not None
        step, position = float(log.time[1] - log.time[0]), log.position.copy()
        for time, jump in self._jumps:
            position[log.time >= time] -= jump.size
        largest = largest_jump(position - displacement_from_velocity(log.lin_vel, step), step, self._offset)
        if largest is None or largest.first > len(position) - 2 * round(HALF_S / step):
            return
        time = float(log.time[largest.first])
        self._jumps = [(at, jump) for at, jump in self._jumps if at >= log.time[0]] + [(time, largest)]
        self._offset = self._offset.add_jump(largest)
        size, std = (dict(zip("xyz", values.tolist(), strict=True)) for values in (largest.size, largest.std))
        interval = {axis: (size[axis] - 1.96 * std[axis], size[axis] + 1.96 * std[axis]) for axis in "xyz"}
        params, kind = {**size, "time": time}, {"name": "position_jump", "sensor": "position"}
        yield SensorFault(flight=self._flight, **kind, params=params, std=std, interval=interval)


WINDOW_BLOCKS = 300  # Number of stored blocks: half a minute
LOOK_BLOCKS = 5  # Number of blocks between two searches
LEAD_BLOCKS = 10  # Number of earlier blocks from which the rotor lag is simulated: many time constants
FIRST_ROWS = 20  # Number of rows that determine the sample rate
SETTLED_S = 2.0  # Time before a failure is named [s]: early, a stuck rotor resembles a failed one
SURE = 0.99  # Least probability among all failures for its naming
AT_LATEST_S = 8.0  # Longest time after onset and first suspicion until a failure is named [s]

SUSPECTED, NAMED, MISFIT = "suspected", "named", "misfit"

STATE = (*COLUMNS["attitude"], *COLUMNS["ang_vel"])  # Required columns


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A failure or sensor fault with the time of its report."""

    stage: str
    """suspected: a failure is certain and this is its most probable kind; named: the kind is certain; misfit: the declared
    vehicle does not fit."""

    failure: Failure | SensorFault | VehicleMisfit
    told_s: float  # Time of the report from the first row [s]

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {
            "stage": self.stage,
            **self.failure.as_mapping(),
            "told_s": self.told_s,
            "delay_s": self.told_s - self.failure.time,
        }


class FlightWatch:
    """Monitors one flight up to a lasting failure; rotors are not monitored while a sensor has stopped."""

    def __init__(
        self, robot: RobotCfg, header: Sequence[str], *, name: str = "flight", torques: bool = True,
        false_alarm_hours: float = FALSE_ALARM_HOURS,
    ) -> None:  # fmt: skip
        """Take the declared robot and the column names; raise ``DataError`` if a required one is missing or one is twice.

        ``torques``: whether the rotor data show torques; slow rows without rotor speeds never do.
        """
        self._robot, self._name, self._place = robot, name, {column.strip(): k for k, column in enumerate(header)}
        self._finder = FailureFinder(robot, false_alarm_hours=false_alarm_hours)
        numbers, rotors = range(1, robot.num_rotors + 1), ("rotor_speed", "rotor_command")
        columns = COLUMNS | {quantity: [COLUMNS[quantity][0].format(n=n) for n in numbers] for quantity in rotors}
        used = {quantity: names for quantity, names in columns.items() if self._place.keys() >= set(names)}
        self._columns = {quantity: [self._place[name] for name in names] for quantity, names in used.items()}
        known = {"t", *(name for names in columns.values() for name in names)}
        if twice := sorted(column for column in known if [name.strip() for name in header].count(column) > 1):
            raise DataError(f"{name}: column {twice[0]!r} appears twice in the header; rename or remove one of them")
        if lacking := [column for column in ("t", *STATE) if column not in self._place]:
            raise DataError(f"{name}: no column {lacking[0]!r}; a log that is watched needs t, {', '.join(STATE)}")
        if self._columns.keys().isdisjoint(rotors):
            raise DataError(
                f"{name}: neither rotor_1..{robot.num_rotors} nor cmd_1..{robot.num_rotors}: log one of them"
            )
        self._torques = torques
        self._stamps = LiveStamps()
        self._rows: list[Array] = []
        self._recent: deque[Array] = deque()
        self._sensors = SensorWatch(name)
        self._last = np.full(len(header), np.nan)
        self._works: list[RotorOutput] = []
        self._size = 0
        self._start: float | None = None
        self._volts: float | None = None
        self._suspected: Failure | None = None
        self._since = 0.0
        self._stateless = 0
        self._fits: bool | None = None  # Whether the declared vehicle fits the first half minute; None: not known yet
        self.last_bad: Finding | None = None  # Reason for the rejection of the last bad row
        self.over = False  # Whether a lasting failure has occurred
        self.watched_s = 0.0

    def add(self, row: Sequence[float] | Array) -> list[Alarm]:
        """Take one row in the header's order, with NaN for empty fields; return the new alarms.

        Rows without a state or with a bad time stamp are dropped. After a clock was set back, time continues by one step.
        Raise ``DataError`` if the number of fields differs from the header's.
        """
        values = np.asarray(row, dtype=float)
        if values.size != len(self._last):
            raise DataError(f"{self._name}: a row has {values.size} fields, the header has {len(self._last)}")
        values = np.where(np.isfinite(values), values, np.nan)
        state = np.where(np.isnan(values), self._last, values)[[self._place[name] for name in STATE]]
        norm = np.linalg.norm(state[: len(COLUMNS["attitude"])])
        if np.isnan(state).any() or abs(norm - 1.0) > NORM_OFF:
            self._stateless += 1
            self.last_bad = Finding("row_without_state")
            return []
        good, bad = self._stamps.add_row(values, self._place["t"]), self._stamps.bad
        if bad:
            self.last_bad = Finding("row_with_bad_stamp", "", {"stamp_s": bad[-1]})
        return [alarm for row in good for alarm in self._process_row(row)]

    def _process_row(self, values: Array) -> list[Alarm]:
        """Take a valid row; return the new alarms."""
        time = self._place["t"]
        values = np.where(np.isnan(values), self._last, values)  # an empty field keeps its last value
        self._start = values[time] if self._start is None else self._start
        if self._rows and values[time] - self._rows[-1][time] > LONGEST_GAP_S:
            self._clear_blocks()
            self._recent.clear()  # positions across the gap are not compared
        self._last = values
        self.watched_s = float(values[time] - self._start)
        self._rows.append(values)
        if not self._size and len(self._rows) >= FIRST_ROWS:
            steps = np.diff([one[time] for one in self._rows])
            self._size = max(1, round(BLOCK_S / float(np.median(steps))))
            fast = 1.0 / float(np.median(steps)) >= SLOWEST_COMMANDS_HZ
            self._torques = self._torques and (fast or "rotor_speed" in self._columns)
        whole = (LEAD_BLOCKS + LOOK_BLOCKS) * self._size
        if self.over or not self._size or len(self._rows) <= whole:
            return []
        faults = self._find_sensor_faults(self._rows[: whole + 1])
        told = [Alarm(stage=NAMED, failure=fault, told_s=self.watched_s) for fault in faults]
        if self._sensors.has_stopped_sensor:
            self._rows, self._works, self._suspected = self._rows[LOOK_BLOCKS * self._size :], [], None
            return told
        self._append_new_blocks(np.array(self._rows[: whole + 1]))
        del self._rows[: LOOK_BLOCKS * self._size]
        return [*told, *self._search_for_failure()]

    @property
    def bad_rows(self) -> int:
        """Return the number of dropped rows."""
        return self._stateless + len(self._stamps.bad)

    @property
    def clock_steps(self) -> int:
        """Return the number of backward clock steps."""
        return self._stamps.steps

    def _clear_blocks(self) -> None:
        self._rows, self._works, self._suspected = [], [], None

    def _find_sensor_faults(self, rows: Sequence[Array]) -> list[SensorFault]:
        """Return the sensor faults in the given rows, which may overlap earlier ones."""
        time = self._place["t"]
        last = self._recent[-1][time] if self._recent else -np.inf
        self._recent.extend(row for row in rows if row[time] > last)
        while self._recent[-1][time] - self._recent[0][time] > WINDOW_S:
            self._recent.popleft()
        log = self._rows_as_log(np.array(self._recent))
        assert self._start is not None
        return self._sensors.find_new_faults(replace(log, time=log.time - self._start))

    def _append_new_blocks(self, rows: Array) -> None:
        """Append the blocks of these rows."""
        flight = self._rows_as_flight(rows)
        assert self._start is not None
        offset = float(rows[0, self._place["t"]]) - self._start
        if self._volts is None and flight.battery is not None:
            self._volts = float(flight.battery.mean())
        new = [
            replace(part, time=part.time + offset).select_blocks(part.time >= (LEAD_BLOCKS - 0.5) * part.length)
            for part in self._finder.works.outputs_of_flight(flight, volts=self._volts)
        ]
        kept = self._works or new
        if self._works:
            kept = [old.append_blocks(part) for old, part in zip(self._works, new, strict=True)]
        self._works = [part.select_blocks(slice(-WINDOW_BLOCKS, None)) for part in kept]

    def _rows_as_log(self, rows: Array) -> FlightLog:
        """Return rows as a log, without quantities with gaps."""
        values = {quantity: rows[:, places] for quantity, places in self._columns.items()}
        whole = {quantity: value for quantity, value in values.items() if not np.isnan(value).any()}
        if "attitude" not in whole:
            raise DataError(f"{self._name}: the attitude is empty at {rows[0, self._place['t']]:g} s")
        if "battery" in whole:
            whole["battery"] = whole["battery"][:, 0]
        time = rows[:, self._place["t"]]
        log = FlightLog(path=self._name, time=time, attitude=whole["attitude"], torques=self._torques)
        return replace(log, **whole)

    def _rows_as_flight(self, rows: Array) -> Flight:
        """Return rows as a flight; low rotor commands (less than half the weight) count as on the ground."""
        log = log_at_equal_steps(replace(self._rows_as_log(rows), position=None))
        told = log.rotor_speed if log.rotor_command is None else log.rotor_command
        assert told is not None
        idle = total_rotor_force(self._robot, told) < IDLE * self._robot.body.mass * STANDARD_GRAVITY
        return complete_flight(log, on_ground=idle if idle.any() else None)

    def _search_for_failure(self) -> list[Alarm]:
        failure = self._finder.find_in_blocks(self._works, self._name) if self._works else None
        told = self._test_vehicle(failure)
        if failure is None:
            self._suspected = None
            return told
        if self._suspected is None:
            self._since = self.watched_s
        seen = self.watched_s - max(failure.time, self._since)
        if (seen >= SETTLED_S and failure.probability >= SURE) or seen >= AT_LATEST_S:
            self.over = "duration" not in failure.params
            self._clear_blocks()
            return [*told, Alarm(stage=NAMED, failure=failure, told_s=self.watched_s)]
        if self._suspected is None:
            told.append(Alarm(stage=SUSPECTED, failure=failure, told_s=self.watched_s))
        self._suspected = failure
        return told

    def _test_vehicle(self, failure: Failure | None, *, ends: bool = False) -> list[Alarm]:
        """Test the declared vehicle before a failure, after ``FIRST_S`` or at the end; return the alarm of a misfit."""
        first = self.watched_s <= FIRST_S and not ends
        if self._fits is not None or (failure is None and first):
            return []
        before = np.inf if failure is None else failure.interval["time"][0]
        works = [work.select_blocks(work.time + work.length < before) for work in self._works]
        misfit = find_misfit(works, self._robot, self._finder.tolerances, self._name)
        if misfit is None:
            self._fits = None if first else True
            return []
        self._fits = False
        return [Alarm(stage=MISFIT, failure=misfit, told_s=self.watched_s)]

    def finish(self) -> list[Alarm]:
        """Return the failure suspected at the end of the rows, since a fallen vehicle leaves little data."""
        self._stamps.reject_pending_rows(self._place["t"])
        failure, self._suspected = self._suspected, None
        if failure is None and self._works:
            return self._test_vehicle(None, ends=True)
        return [Alarm(stage=NAMED, failure=failure, told_s=self.watched_s)] if failure else []
