"""Detection of sensor faults during a flight by the rules for complete logs, applied to its last seconds. Letters: T rows."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.failures.flight_event import FlightEvent
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.position_jumps import (
    HALF_S,
    PositionJump,
    PositionOffset,
    displacement_from_velocity,
    largest_jump,
)
from aerial_gym.sim2real.logs.recording import FlightLog, take_rows
from aerial_gym.sim2real.logs.sample_repeats import (
    LONGEST_FROZEN_S,
    find_frozen_sensors,
    mend_repeated_samples,
    rows_of_last_change,
)
from aerial_gym.sim2real.logs.signals import log_at_equal_steps

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
        self._since = -np.inf
        """Start of the compared positions [s], after the last sensor dropout."""
        self._stopped: dict[str, float] = {}
        """Stopped sensors, with the time of their last change [s]."""
        self._jumps: list[tuple[float, PositionJump]] = []
        self._offset = PositionOffset()
        """Sum of all jumps, earlier ones included."""

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
