"""Rate, jitter and loss of the commands on their link, their latency, and flown per commanded body rate.

Letters: T rows, K commands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.rotor_model import rotor_thrusts
from aerial_gym.sim2real.logs.signals import lowpass, num_edge_rows
from aerial_gym.sim2real.preflight.constants import Constant
from aerial_gym.sim2real.statistics import Estimate, chi_square_tail
from aerial_gym.sim2real.teststand.effectiveness import fit_with_jackknife_interval, rows_without_each_part
from aerial_gym.sim2real.teststand.log_geometry import layout_of_robot

BAND_HZ = (0.5, 12.0)  # Frequencies of the comparison of commands with the rate loop; slower are those of integrators
LARGEST_S, TRIAL_S = 0.2, 0.005  # Largest latency of the search, and distance of its trials [s]
GAINS, TRIALS = (0.4, 2.5), 75  # Range of flown per commanded body rates that is searched, and number of trials
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
    own = [log for log in logs if log.log_format == "csv"]
    rate, jitter, loss = arrival_statistics(own)
    latency, gains = rate_loop_constants(own, robot)
    shown = "no_rate_setpoint" if not any("rate_setpoint" in log.setpoints for log in logs) else "few_commands"
    arrived = shown if own else "commands_of_firmware"
    constants = [
        Constant(name="link_rate", kind="link_rate", declared=training.rate or 0.0, unit="Hz", reason=arrived,
                 estimate=rate, setting="the rate of the policy in training", new=rate and rate.value),
        Constant(name="link_jitter", kind="link_jitter", declared=training.jitter, unit="s", reason=arrived,
                 estimate=jitter, setting="the jitter of commands in training", new=jitter and jitter.value),
        Constant(name="packet_loss", kind="packet_loss", declared=training.loss, reason=arrived, estimate=loss,
                 setting="the dropout of commands in training", new=loss and loss.value),
        Constant(name="command_latency", kind="command_latency", declared=training.latency, unit="s", reason=arrived,
                 estimate=latency, setting="the action delay_steps of the task", new=latency and latency.value),
    ]  # fmt: skip
    if training.rate is None:
        constants = constants[1:]
    gained = [Constant(name=f"rate_gain_{axis}", kind="rate_gain", declared=1.0, reason=arrived, estimate=gain,
                       setting=f"the factor of the commanded rate about {axis}", new=None if gain is None else 1.0 / gain.value)
              for axis, gain in zip("xyz", gains, strict=True)]  # fmt: skip
    return [*constants, *gained]


def arrival_statistics(logs: Sequence[FlightLog]) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
    """Return rate [Hz], jitter [s] and loss of commands, by the variance of the time between commands.

    Commands of period h arrive with a delay of variance s², and a share p never. Over m arrivals the time has the mean
    ``m h / (1 - p)`` and the variance ``2 s² + m h² p / (1 - p)²``: lost commands add up, delays do not. A steady clock of the
    sender shows h more precisely. Spans end where the logger lost rows.
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

    kept = rows_without_each_part([len(chains)])
    rate, jitter, loss = map(Estimate.from_half_width, *fit_with_jackknife_interval(moments, kept))
    if (clock := _rate_of_clock(chains, rate)) is None:
        return rate, jitter, loss
    counts, spans = (np.array([f(chain) for chain in chains]) for f in (lambda one: one.size - 1.0, np.ptp))

    def share_without_arrival(rows: Flags) -> Array:
        return np.atleast_1d(1.0 - counts[rows].sum() / (clock.value * spans[rows].sum()))

    (value,), (half,) = fit_with_jackknife_interval(share_without_arrival, kept)
    return clock, jitter, Estimate.from_half_width(value, float(np.hypot(half, clock.high / clock.value - 1.0)))


def _rate_of_clock(chains: Sequence[Array], near: Estimate) -> Estimate | None:
    """Return the rate of a steady clock [Hz] that sends the commands of all chains; None if Rayleigh's test shows none.

    At the rate f of the clock the phases ``2 pi f t`` of arrivals agree, even beside lost commands and with jitter. Without a
    clock ``2 |sum exp(2 pi i f t)|² / n`` of each chain follows a chi-squared distribution with two degrees of freedom.
    """
    width, longest = max(near.high - near.value, 0.02 * near.value), max(float(np.ptp(chain)) for chain in chains)
    trials = np.arange(near.value - width, near.value + width, 0.2 / longest)
    phases = (np.exp(2j * np.pi * trials[:, None] * (chain - chain[0])) for chain in chains)
    power = sum((2.0 * np.abs(one.sum(axis=1)) ** 2 / one.shape[1] for one in phases), np.zeros(trials.size))
    if chi_square_tail(float(power.max()), 2.0 * len(chains)) * trials.size > 0.01:
        return None
    return Estimate.from_half_width(float(trials[int(np.argmax(power))]), 0.5 / longest)


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


def rate_loop_constants(logs: Sequence[FlightLog], robot: RobotCfg) -> tuple[Estimate | None, list[Estimate | None]]:
    """Return the latency of commanded body rates [s], and the flown per commanded body rate about each axis.

    A rate loop makes a torque ``P e + I integral(e) - D w'``, less gyroscopic torques, of the error ``e = g r(t - L) - w`` of a
    command r and the rate w. The least residual of this regression shows L and g. No number of vehicle or firmware enters.
    """
    parts = [_RateLoopSignals.from_log(log, robot) for log in logs if _shows_rate_loop(log)]
    if not parts:
        return None, [None] * AXES
    trials = np.arange(-1, round(LARGEST_S / TRIAL_S) + 1) * TRIAL_S
    kept = rows_without_each_part([len(part.rows) for part in parts])

    def products(late: float, rows: Flags) -> Array:
        table = np.concatenate([part.table(late) for part in parts])[rows].swapaxes(0, 1)
        return np.swapaxes(table, 1, 2) @ table  # of all columns, (3, 7, 7)

    whole = np.ones(kept[0].size, dtype=bool)
    sums = {rows.tobytes(): np.stack([products(late, rows) for late in trials]) for rows in (whole, *kept)}

    def latency(rows: Flags) -> Array:
        left = np.array([sum(map(_residual_share, each)) for each in sums[rows.tobytes()]])
        best = int(np.argmin(left))
        if best in (0, trials.size - 1):
            return trials[best : best + 1]
        before, here, after = left[best - 1 : best + 2]
        return np.array([trials[best] + 0.5 * TRIAL_S * (before - after) / (before - 2.0 * here + after)])

    value, half = fit_with_jackknife_interval(latency, kept)
    nearest = int(np.argmin(np.abs(trials - value[0])))

    def gains(rows: Flags) -> Array:
        return np.array([_gain_of_command(one) for one in sums[rows.tobytes()][nearest]])

    gain, wide = fit_with_jackknife_interval(gains, kept)
    moved = np.sqrt(np.mean(np.concatenate([part.asked[..., 0] for part in parts]) ** 2, axis=0))
    estimates = [
        Estimate.from_half_width(g, w) if m > LEAST_RATE and 1.01 * GAINS[0] < g < 0.99 * GAINS[1] else None
        for g, w, m in zip(gain, wide, moved, strict=True)
    ]
    resolution = 0.5 / min(part.rate for part in parts)
    return Estimate.from_half_width(float(value[0]), max(float(half[0]), resolution)), estimates


def _residual_share(products: Array) -> float:
    """Return the share of the last column that the motion do not explain, by the products of all columns."""
    outer = products[:-1, -1]
    return 1.0 - float(outer @ np.linalg.pinv(products[:-1, :-1], hermitian=True) @ outer) / float(products[-1, -1])


def _gain_of_command(products: Array) -> float:
    """Return the gain of the command and its integral with the least residual, by the products of all columns (7, 7).

    Neither the proportional nor the integral gain of a rate loop is negative, which excludes a second minimum.
    """

    def residual(gain: float) -> float:
        errors = np.zeros((5, 7))  # of rate and of its integral; the other columns stay
        errors[0, [0, 2]] = errors[1, [1, 3]] = gain, -1.0
        errors[[2, 3, 4], [4, 5, 6]] = 1.0
        reduced = errors @ products @ errors.T
        gains = np.linalg.pinv(reduced[:-1, :-1], hermitian=True) @ reduced[:-1, -1]
        kept = [k for k in range(5) if k > 1 or gains[k] >= 0.0]
        return _residual_share(reduced[np.ix_(kept, kept)])

    trials = np.geomspace(*GAINS, TRIALS)
    best = int(np.argmin([residual(gain) for gain in trials]))
    near = (trials[max(best - 1, 0)], trials[min(best + 1, TRIALS - 1)])
    best_gain = minimize_scalar(residual, bounds=near, method="bounded", options={"xatol": 1e-4})
    return float(best_gain["x"])  # type: ignore[index]


@dataclass(frozen=True, kw_only=True)
class _RateLoopSignals:
    """Signals of a rate loop in the band of the comparison, (T, 3) each; ``asked`` has the command and its integral."""

    asked: Array  # (T, 3, 2)
    motion: Array  # Body rate, its integral and derivative, product of the other rates, and last the torque, (T, 3, 5)
    rows: Indices  # Rows of the comparison
    rate: float

    @classmethod
    def from_log(cls, log: FlightLog, robot: RobotCfg) -> "_RateLoopSignals":
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

        asked = latest_rate_setpoint(log)
        sums = [np.cumsum(one - one.mean(axis=0), axis=0) / rate for one in (asked, turning)]
        products = np.stack([turning[:, j] * turning[:, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
        change = np.gradient(turning, axis=0) * rate
        edge = num_edge_rows(rate, low) + round((LARGEST_S + TRIAL_S) * rate)
        return cls(
            asked=band(asked, sums[0]), motion=band(turning, sums[1], change, products, torque), rate=rate,
            rows=np.arange(edge, len(turning) - edge, max(1, int(rate / (4.0 * high)))),
        )  # fmt: skip

    def table(self, late: float) -> Array:
        """Return regressors with the command so late [s], and last the torque, (rows, 3, 7)."""
        moved = self.asked[self.rows - round(late * self.rate)]
        return np.concatenate((moved, self.motion[self.rows]), axis=2)


def latest_rate_setpoint(log: FlightLog) -> Array:
    """Return the latest commanded body rate in each row, (T, 3)."""
    time, values = log.setpoints["rate_setpoint"]
    place = np.searchsorted(time, log.time + 0.5 / sample_rate(log), side="right") - 1
    return values[np.clip(place, 0, None)]


def _shows_rate_loop(log: FlightLog) -> bool:
    """Return whether a log has fast rotor commands of its own beside commanded body rates."""
    timing = log.streams.get("rotor_command")
    fast = min(sample_rate(log), np.inf if timing is None else timing.rate) >= FIRMWARE_HZ
    return fast and log.rotor_command is not None and "rate_setpoint" in log.setpoints and log.ang_vel is not None
