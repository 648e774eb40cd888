"""Constants of a vehicle and its link: the value in the file, the value in the log, and the verdict on both."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.statistics import Estimate, student_quantile
from aerial_gym.sim2real.teststand.vehicle_from_log import WIDEST

MEASURED, ASSUMED, CONTRADICTED = "measured", "assumed", "contradicted"

CODES = {MEASURED: "constant_measured", ASSUMED: "constant_assumed", CONTRADICTED: "constant_contradicted"}

TOLERANCES = {
    "gyro_scale": 0.015,  # Half the limit of a common gyro, as in ``predict.tolerances``
    "accelerometer_scale": 0.015,  # Three standard deviations after a calibration on six sides
    "thrust_per_weight": 0.04,  # Thrust of propellers of one type, and the weight of a battery or a strap
    "thrust_exponent": 0.1,  # Propellers have 1.9 to 2.1 in bench records
    "inertia": 0.15,  # Computed from parts; a swing test is better
    "torque_ratio": 0.12,  # As the inertia about yaw, by which it is measured
    "rotor_lag": 0.25,  # Bench records of one motor differ by so much between rises and falls
    "motor_latency": 0.009,  # Three standard deviations of the delay of a rotor log [s]
    "command_latency": 0.008,  # One step of a policy at 100 Hz, less the stamps of a log [s]
    "state_latency": 0.015,  # The same and the filters of a sound logger [s]
    "rate_gain": 0.05,  # Rate tables of firmware have steps of some per cent
    "link_rate": 0.05,  # Clocks of computers are exact; a scheduler of a slow task is not
    "link_jitter": 0.003,  # Standard deviation of the arrival [s]: a quarter of a step of most policies
    "packet_loss": 0.01,  # Share
    "speed_per_command": 0.0015,  # 0.025 V of 16 V: converters of flight controllers resolve 10 mV
}
"""Largest deviation from the file that is no contradiction, by the kind of a constant: relative, or in its unit."""

RELATIVE = ("inertia", "torque_ratio", "rotor_lag", "link_rate")  # Kinds with a relative tolerance


@dataclass(frozen=True, kw_only=True)
class Constant:
    """One constant."""

    name: str
    kind: str  # A key of ``TOLERANCES``
    declared: float  # Value of the file, or of the training
    unit: str = ""
    estimate: Estimate | None = None  # By the log; None if the log cannot show it
    reason: str = ""  # Why the log cannot show it
    setting: str = ""  # The number of the file to change
    new: float | None = None  # Its new value
    tied: tuple[str, ...] = ()  # Other causes that look the same in this log
    remedy: str = ""  # A measurement that separates them

    @property
    def tolerance(self) -> float:
        """Largest deviation that is no contradiction, in the unit of the constant."""
        return TOLERANCES[self.kind] * (abs(self.declared) if self.kind in RELATIVE else 1.0)

    @property
    def state(self) -> str:
        """One of measured, assumed and contradicted.

        A contradicted value lies outside the interval by more than the tolerance. An interval wider than that shows nothing.
        A relative number is measured only to ``WIDEST``, as in ``robot from-log``.
        """
        if self.estimate is None:
            return ASSUMED
        half_width = 0.5 * (self.estimate.high - self.estimate.low)
        if self.kind in RELATIVE and half_width > WIDEST * abs(self.estimate.value):
            return ASSUMED
        low, high = self.estimate.low - self.tolerance, self.estimate.high + self.tolerance
        if not low <= self.declared <= high:
            return CONTRADICTED
        return MEASURED if half_width <= self.tolerance else ASSUMED

    def finding(self) -> Finding:
        """Return the constant as a finding."""
        values: dict[str, object] = {"declared": self.declared, "unit": self.unit, "tolerance": self.tolerance}
        if self.estimate is not None:
            one = self.estimate
            values |= {"value": one.value, "low": one.low, "high": one.high}
        if self.state == ASSUMED:
            values["reason"] = self.reason if self.estimate is None else "interval"
        if self.state == CONTRADICTED:
            values |= {"setting": self.setting, "new": self.new, "tied": list(self.tied), "remedy": self.remedy}
        return Finding(CODES[self.state], self.name, values)


def pool(parts: Sequence[Estimate], *, scatter: bool = True) -> Estimate | None:
    """Return the mean of estimates by their precision. With ``scatter``, that beyond their intervals widens that of the mean.

    Source: Birge (1932), The calculation of errors by the method of least squares (ratio of outer to inner consistency), with
    Student's quantile for the scatter of few parts.
    """
    known = [one for one in parts if np.isfinite(one.high - one.low) and one.high > one.low]
    if not known:
        return None
    value, std = (np.array(x) for x in zip(*((one.value, (one.high - one.low) / 3.92) for one in known), strict=True))
    weight = std**-2.0
    mean, freedom = float(weight @ value / weight.sum()), max(len(known) - 1, 1)
    excess = scatter * max(float(weight @ (value - mean) ** 2) / freedom - 1.0, 0.0)
    quantiles = 1.96**2 + float(student_quantile(0.975, freedom)) ** 2 * excess
    return Estimate.from_half_width(mean, float(np.sqrt(quantiles / weight.sum())))
