"""Rate, jitter and loss of the commands on their link, their latency, and flown per commanded body rate.

Letters: T rows, K commands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.rotor_model import rotor_thrusts
from aerial_gym.sim2real.logs.signals import lowpass, num_edge_rows
from aerial_gym.sim2real.preflight.constants import Constant
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.effectiveness import fit_with_jackknife_interval, rows_without_each_part
from aerial_gym.sim2real.teststand.log_geometry import layout_of_robot

BAND_HZ = (0.5, 15.0)  # Frequencies of the comparison of commands with the rate loop; slower are those of integrators
LARGEST_S, TRIAL_S = 0.2, 0.005  # Largest latency of the search, and distance of its trials [s]
BIN_S, TAPS = 0.025, 40  # Step and number of the impulse response from commanded to flown rate: one second
AXES = 3
LAGS = range(4, 21)  # Numbers of commands whose time is compared: more than a queue delays
FEWEST_SPANS = 4  # Least number of spans without lost rows
LEAST_RATE = 0.1  # Least RMS of commanded body rates that shows how they are flown [rad/s]
FIRMWARE_HZ = 150.0  # Least rate of rotor commands that shows the reaction of a rate loop [Hz]


@dataclass(frozen=True, kw_only=True)
class TrainingLink:
    """Link that a policy was trained with."""

    rate: float | None = None  # Commands per second [Hz]; None: not known
    latency: float = 0.0  # Latency of commands [s]
    jitter: float = 0.0  # Standard deviation of their arrival [s]
    loss: float = 0.0  # Share of lost commands


def check_link(logs: Sequence[FlightLog], robot: RobotCfg, training: TrainingLink) -> list[Constant]:
    """Return the constants of the link by logs at equal steps, with correct sensors and rotors."""
    rate, jitter, loss = arrival_statistics(logs)
    latency, gains = _command_latency(logs, robot), _rate_gains(logs)
    shown = "no_rate_setpoint" if not any("rate_setpoint" in log.setpoints for log in logs) else "few_commands"
    constants = [
        Constant(name="link_rate", kind="link_rate", declared=training.rate or 0.0, unit="Hz", reason=shown,
                 estimate=rate, setting="rate of the policy in training", new=rate and rate.value),
        Constant(name="link_jitter", kind="link_jitter", declared=training.jitter, unit="s", reason=shown,
                 estimate=jitter, setting="jitter of commands in training", new=jitter and jitter.value),
        Constant(name="packet_loss", kind="packet_loss", declared=training.loss, reason=shown, estimate=loss,
                 setting="dropout of commands in training", new=loss and loss.value),
        Constant(name="command_latency", kind="command_latency", declared=training.latency, unit="s", reason=shown,
                 estimate=latency, setting="action delay_steps of the task", new=latency and latency.value),
    ]  # fmt: skip
    if training.rate is None:
        constants = constants[1:]
    gained = [Constant(name=f"rate_gain_{axis}", kind="rate_gain", declared=1.0, reason=shown, estimate=gain,
                       setting=f"factor of the commanded rate about {axis}", new=None if gain is None else 1.0 / gain.value)
              for axis, gain in zip("xyz", gains, strict=True)]  # fmt: skip
    return [*constants, *gained]


def arrival_statistics(logs: Sequence[FlightLog]) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
    """Return rate [Hz], jitter [s] and loss of commands, by the variance of the time between commands.

    Commands of period h arrive with a delay of variance s², and a share p never. Over m arrivals the time has the mean
    ``m h / (1 - p)`` and the variance ``2 s² + m h² p / (1 - p)²``: lost commands add up, delays do not. Spans end where the
    logger lost rows.
    """
    chains = [chain for log in logs for chain in _spans_of_arrivals(log) if chain.size > 2 * LAGS[-1]]
    if len(chains) < FEWEST_SPANS:
        return None, None, None

    def moments(rows: Flags) -> Array:
        own = [chain for chain, taken in zip(chains, rows, strict=True) if taken]
        spans = [np.concatenate([chain[lag:] - chain[:-lag] for chain in own]) for lag in LAGS]
        step = float(np.mean(spans[-1])) / LAGS[-1]
        slope, twice = np.polyfit(
            LAGS, [np.mean((one - step * lag) ** 2) for one, lag in zip(spans, LAGS, strict=True)], 1
        )
        loss = slope / step**2
        return np.array((1.0 / (step * (1.0 - loss)), max(0.5 * twice, 0.0) ** 0.5, loss))

    value, half = fit_with_jackknife_interval(moments, rows_without_each_part([len(chains)]))
    rate, jitter, loss = map(Estimate.from_half_width, value, half)
    return rate, jitter, loss


def _spans_of_arrivals(log: FlightLog) -> list[Array]:
    """Return the times of commands [s] in each span without lost rows."""
    if "rate_setpoint" not in log.setpoints:
        return []
    time = log.setpoints["rate_setpoint"][0]
    time = time[(time >= log.time[0]) & (time <= log.time[-1])]
    if log.lost is None:
        return [time]
    lost = np.concatenate(([0], np.cumsum(log.lost)))
    count = lost[np.searchsorted(log.time, time)]
    return np.split(time, np.flatnonzero(np.diff(count)) + 1)


def _command_latency(logs: Sequence[FlightLog], robot: RobotCfg) -> Estimate | None:
    """Return the time between a commanded body rate and the reaction of the rotor commands [s].

    A rate loop makes a torque ``P (r(t - L) - w) + I integral(r(t - L) - w) - D w'``, less gyroscopic torques, of the command r
    and the rate w. The least residual of this regression shows L. No number of vehicle or firmware enters.
    """
    parts = [_FilteredRateLoop.of(log, robot) for log in logs if _shows_rate_loop(log)]
    if not parts:
        return None
    rate = min(part.rate for part in parts)
    trials = np.arange(-1, round(LARGEST_S / TRIAL_S) + 1) * TRIAL_S
    sizes = [len(part.rows) for part in parts]
    tables = np.concatenate([np.stack([part.table(late) for late in trials]) for part in parts], axis=1)
    columns = tables.shape[-1]

    def latency(rows: Flags) -> Array:
        left = np.zeros(trials.size)
        for axis in range(AXES):
            one = tables[:, rows, axis]
            products = np.swapaxes(one, 1, 2) @ one  # regressors and torque, (trials, columns, columns)
            inner, outer = products[:, : columns - 1, : columns - 1], products[:, : columns - 1, -1:]
            explained = (np.linalg.pinv(inner, hermitian=True) @ outer)[..., 0]
            left += 1.0 - (explained * outer[..., 0]).sum(axis=1) / products[:, -1, -1]
        best = int(np.argmin(left))
        if best in (0, trials.size - 1):
            return trials[best : best + 1]
        before, here, after = left[best - 1 : best + 2]
        return np.array([trials[best] + 0.5 * TRIAL_S * (before - after) / (before - 2.0 * here + after)])

    value, half = fit_with_jackknife_interval(latency, rows_without_each_part(sizes))
    return Estimate.from_half_width(float(value[0]), max(float(half[0]), 0.5 / rate))


@dataclass(frozen=True, kw_only=True)
class _FilteredRateLoop:
    """Signals of a rate loop in the band of the comparison, (T, 3) each; ``asked`` has the command and its integral."""

    asked: Array  # (T, 3, 2)
    others: Array  # Body rate, its integral and derivative, product of the other rates, and last the torque, (T, 3, 5)
    rows: Indices  # Rows of the comparison
    rate: float

    @classmethod
    def of(cls, log: FlightLog, robot: RobotCfg) -> "_FilteredRateLoop":
        """Return the signals of a log."""
        assert log.rotor_command is not None
        assert log.ang_vel is not None
        weights = layout_of_robot(robot).weights
        assert weights is not None
        rate, (low, high), turning = sample_rate(log), BAND_HZ, log.ang_vel
        torque = rotor_thrusts(robot, log.rotor_command) @ weights.T

        def band(*columns: Array) -> Array:
            values = np.stack(columns, axis=2)
            return lowpass(values, rate, high) - lowpass(values, rate, low)

        asked = held_rate_setpoint(log)
        sums = [np.cumsum(one - one.mean(axis=0), axis=0) / rate for one in (asked, turning)]
        products = np.stack([turning[:, j] * turning[:, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
        change = np.gradient(turning, axis=0) * rate
        edge = num_edge_rows(rate, low) + round((LARGEST_S + TRIAL_S) * rate)
        return cls(
            asked=band(asked, sums[0]), others=band(turning, sums[1], change, products, torque), rate=rate,
            rows=np.arange(edge, len(turning) - edge, max(1, int(rate / (4.0 * high)))),
        )  # fmt: skip

    def table(self, late: float) -> Array:
        """Return regressors with the command so late [s], and last the torque, (rows, 3, 7)."""
        moved = self.asked[self.rows - round(late * self.rate)]
        return np.concatenate((moved, self.others[self.rows]), axis=2)


def held_rate_setpoint(log: FlightLog) -> Array:
    """Return the latest commanded body rate in each row, (T, 3)."""
    time, values = log.setpoints["rate_setpoint"]
    place = np.searchsorted(time, log.time + 0.5 / sample_rate(log), side="right") - 1
    return values[np.clip(place, 0, None)]


def _rate_gains(logs: Sequence[FlightLog]) -> list[Estimate | None]:
    """Return the flown per commanded body rate in the steady state of each axis: the sum of a finite impulse response."""
    logs = [log for log in logs if "rate_setpoint" in log.setpoints and log.ang_vel is not None]
    if not logs:
        return [None] * AXES
    pairs = [(_means(held_rate_setpoint(log), log), _means(log.ang_vel, log)) for log in logs]  # type: ignore[arg-type]
    kept = rows_without_each_part([len(asked) - TAPS + 1 for asked, _ in pairs])
    return [_impulse_gain([(a[:, k], w[:, k]) for a, w in pairs], kept) for k in range(AXES)]


def _impulse_gain(pairs: Sequence[tuple[Array, Array]], kept: Sequence[Flags]) -> Estimate | None:
    tables = [np.lib.stride_tricks.sliding_window_view(asked, TAPS) for asked, _ in pairs]
    table, target = np.concatenate(tables), np.concatenate([turning[TAPS - 1 :] for _, turning in pairs])
    table = np.column_stack((table, np.ones(len(table))))
    if np.std(table[:, 0]) < LEAST_RATE:
        return None

    def gain(rows: Flags) -> Array:
        return np.linalg.lstsq(table[rows], target[rows], rcond=None)[0][None, :TAPS].sum(axis=1)

    value, half = fit_with_jackknife_interval(gain, kept)
    return Estimate.from_half_width(float(value[0]), float(half[0]))


def _means(values: Array, log: FlightLog) -> Array:
    """Return means over ``BIN_S``, (bins, 3)."""
    rows = max(1, round(BIN_S * sample_rate(log)))
    count = len(values) // rows
    return values[: count * rows].reshape(count, rows, -1).mean(axis=1)


def _shows_rate_loop(log: FlightLog) -> bool:
    """Return whether a log has fast rotor commands of its own beside commanded body rates."""
    timing = log.streams.get("rotor_command")
    fast = min(sample_rate(log), np.inf if timing is None else timing.rate) >= FIRMWARE_HZ
    return fast and log.rotor_command is not None and "rate_setpoint" in log.setpoints and log.ang_vel is not None
