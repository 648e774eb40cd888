"""Allan deviation of the simulated IMUs against their files: ``python -m benchmarks.devices.imu_allan --out DIR``.

Every preset lies still, many of them side by side, in two records: at ``FAST_DT``, where white noise rules, and with long
steps, where the bias walks. From the Allan variance of each sensor the noise density N and the bias walk K are fitted; the
mean over the sensors has a 95 % interval from their scatter. Beside them stands the deviation about where the lines
``N / sqrt(tau)`` and ``K sqrt(tau / 3)`` meet, the lowest of the curve: the bias instability of a data sheet as far as this
model has one (it has no flicker noise of its own).
Source: IEEE Std 952-1997, annexes B and C; El-Sheimy, Hou, Niu (2008), Analysis and Modeling of Inertial Sensors Using Allan
Variance, IEEE Trans. Instrumentation and Measurement 57(1).
Letters: T samples, S sensors, K averaging times, C channels (accelerometer x y z, gyro x y z).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

import torch
import tyro
from torch import Tensor

from aerial_gym.config.sensor import ImuCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ShapeError
from aerial_gym.math.random import Randomness
from aerial_gym.sensors import IMUS, Imu
from aerial_gym.sensors.mounts import Carrier
from benchmarks.markdown import table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CHANNELS = tuple((kind, axis) for kind in ("accel", "gyro") for axis in "xyz")
UNITS = {"accel": "m/s²", "gyro": "rad/s"}

FAST_DT = 0.01  # Step of the first record [s]: an environment step of the registered sims
SLOW_SHARE = 1.0 / 256.0  # Step of the second record per averaging time at which the slower channel's lines meet
LEFT_OUT = 3  # Longest averaging times that are left out of the lowest deviation: they come from fewer than 16 averages
NORMAL_95 = 1.96  # Half of a 95 % interval in standard errors


AllanRow = dict[str, str | int | float]
"""One axis of one IMU: ``noise``, ``walk`` and ``lowest``, each ``_configured``, ``_found``, ``_low`` and ``_high``.

Densities: accelerometer in m/s², gyro in rad/s, N per sqrt(Hz), K per s and sqrt(Hz). ``lowest`` is the Allan deviation at the
averaging time ``lowest_at_s`` [s] nearest to where both lines meet.
"""


def allan_deviation(samples: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Return averaging times and the overlapping Allan deviation at each.

    With the integral theta of the signal, ``sigma²(tau) = <(theta(t + 2 tau) - 2 theta(t + tau) + theta(t))²> / (2 tau²)``.

    Args:
        samples: One signal per column, (T, ...), T >= 2.

    Returns:
        Averaging times m dt [s] for m = 1, 2, 4, ... up to T / 2, float64, (K,), and the deviation in the unit of the signal,
        float64, (K, ...). Of one signal its relative error is about ``1 / sqrt(2 (T / m - 1))``.
    """
    count = samples.shape[0]
    if count < 2:
        raise ShapeError(f"samples has shape {tuple(samples.shape)}: the first axis must hold at least two samples")
    signal = samples.double()
    signal = signal - signal.mean(0)  # changes nothing but round-off
    theta = torch.cat((torch.zeros_like(signal[:1]), signal.cumsum(0) * dt))
    sizes = [2**k for k in range((count // 2).bit_length())]
    rows = []
    for m in sizes:
        second = theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]
        rows.append((second.square().mean(0) / (2.0 * (m * dt) ** 2)).sqrt())
    return torch.tensor(sizes, dtype=torch.float64, device=samples.device) * dt, torch.stack(rows)


def record_at_rest(cfg: ImuCfg, *, num_sensors: int, num_samples: int, dt: float, seed: int) -> Tensor:
    """Return measurements [m/s², rad/s] of IMUs at rest and level, every ``dt`` [s], float32, (T, S, 6)."""
    attitude = torch.zeros(num_sensors, 4)
    attitude[:, 3] = 1.0
    still, measurement = torch.zeros(num_sensors, 3), torch.zeros(num_sensors, 6)
    random, every = Randomness(num_sensors, seed=seed), torch.ones(num_sensors, dtype=torch.bool)
    body = Carrier(position=still, attitude=attitude, lin_vel=still, ang_vel=still)
    imu = Imu(cfg, body, measurement_out=measurement, dt=dt, gravity=STANDARD_GRAVITY, random=random)
    random.begin(every)
    imu.reset(every)
    samples = torch.empty(num_samples, num_sensors, 6)
    for row in samples:
        imu.measure()
        row.copy_(measurement)
    return samples


def crossing_s(noise: float, walk: float) -> float:
    """Return the averaging time [s] at which ``N / sqrt(tau)`` and ``K sqrt(tau / 3)`` meet."""
    return sqrt(3.0) * noise / walk


def variance_shares(tau: Tensor, dt: float) -> Tensor:
    """Return the Allan variance of N = 1 and of K = 1 sampled every ``dt`` [s] at times ``tau`` [s], (K, 2).

    ``1 / tau`` and ``tau / 3 (1 + 1 / (2 m²))`` with m = tau / dt. Derived: the variance of the difference of neighbouring
    averages of m samples of a walk with unit steps is ``(2 m² + 1) / (3 m)``.
    """
    return torch.stack((1.0 / tau, tau / 3.0 * (1.0 + 0.5 * (dt / tau) ** 2)), dim=-1)


def fit_densities(tau: Tensor, deviation: Tensor, dt: float, truth: Tensor) -> Tensor:
    """Return N² and K² of each signal, fitted to its Allan deviation (K, S) at times ``tau`` (K,) [s], (S, 2).

    Least squares of the variance, whose relative errors are taken to grow with ``sqrt(tau)``. ``truth``, N² and K², weighs the
    residuals; the fit is unbiased whatever it is.
    """
    parts = variance_shares(tau, dt) * truth
    weight = 1.0 / (parts.sum(-1, keepdim=True) * tau.sqrt().unsqueeze(-1))
    return torch.linalg.lstsq(parts * weight, deviation.square() * weight).solution.T * truth


def root_mean_interval(squares: Tensor) -> tuple[float, float, float]:
    """Return the root of the mean of squares, (S,), and of the ends of its 95 % interval."""
    mean, error = float(squares.mean()), float(squares.std()) / sqrt(len(squares))
    low, high = mean - NORMAL_95 * error, mean + NORMAL_95 * error
    return sqrt(max(mean, 0.0)), sqrt(max(low, 0.0)), sqrt(max(high, 0.0))


@dataclass(frozen=True, kw_only=True)
class AllanRecord:
    """Allan deviation of one record."""

    dt: float
    tau: Tensor  # (K,) [s]
    deviation: Tensor  # (K, S, C)

    @classmethod
    def simulate(cls, cfg: ImuCfg, *, dt: float, num_sensors: int, num_samples: int, seed: int) -> "AllanRecord":
        """Return the deviation of IMUs at rest."""
        samples = record_at_rest(cfg, num_sensors=num_sensors, num_samples=num_samples, dt=dt, seed=seed)
        tau, deviation = allan_deviation(samples, dt)
        return cls(dt=dt, tau=tau, deviation=deviation)


def channel_densities(cfg: ImuCfg) -> list[tuple[float, float]]:
    """Return N and K of every channel."""
    noise = (*cfg.accel_noise_density, *cfg.gyro_noise_density)
    return list(zip(noise, (*cfg.accel_bias_walk, *cfg.gyro_bias_walk), strict=True))


def fast_and_slow_records(
    cfg: ImuCfg, *, num_sensors: int, num_samples: int, seed: int
) -> tuple[AllanRecord, AllanRecord]:
    """Return the fast and the slow record of an IMU."""
    slow = SLOW_SHARE * max(crossing_s(noise, walk) for noise, walk in channel_densities(cfg))
    size = {"num_sensors": num_sensors, "num_samples": num_samples}
    fast = AllanRecord.simulate(cfg, dt=FAST_DT, seed=seed, **size)
    return fast, AllanRecord.simulate(cfg, dt=slow, seed=seed + 1, **size)


def compare_densities(name: str, cfg: ImuCfg, fast: AllanRecord, slow: AllanRecord) -> list[AllanRow]:
    """Return the densities of every channel: N from the fast record, K from the slow one, the lowest deviation from either."""
    rows = []
    for channel, ((noise, walk), (sensor, axis)) in enumerate(zip(channel_densities(cfg), CHANNELS, strict=True)):
        truth = torch.tensor([noise, walk], dtype=torch.float64).square()
        squares = [fit_densities(r.tau, r.deviation[:, :, channel], r.dt, truth) for r in (fast, slow)]
        record, at = lowest_point(crossing_s(noise, walk), fast, slow)
        expected = float((variance_shares(record.tau[at : at + 1], record.dt) * truth).sum().sqrt())
        row: AllanRow = {"imu": name, "sensor": sensor, "axis": axis, "num_sensors": fast.deviation.shape[1]}
        for quantity, configured, samples in (
            ("noise", noise, squares[0][:, 0]),
            ("walk", walk, squares[1][:, 1]),
            ("lowest", expected, record.deviation[at, :, channel].square()),
        ):
            names = (f"{quantity}_{end}" for end in ("configured", "found", "low", "high"))
            row |= zip(names, (configured, *root_mean_interval(samples)), strict=True)
        rows.append(row | {"lowest_at_s": float(record.tau[at])})
    return rows


def lowest_point(at_s: float, *both: AllanRecord) -> tuple[AllanRecord, int]:
    """Return the record, and the place in it, whose averaging time is nearest to a time [s], of those averaged often."""
    points = [
        (abs(log(float(tau) / at_s)), record, place)
        for record in both
        for place, tau in enumerate(record.tau[:-LEFT_OUT])
    ]
    return min(points, key=lambda point: point[0])[1:]


@dataclass(frozen=True, kw_only=True)
class ImuAllanCmd:
    """Compare simulated IMUs at rest with the densities in their files, and draw their Allan deviation."""

    out: Path  # Folder that receives imu_allan.png
    imu: tuple[str, ...] = ("vn100", "bmi088", "base_imu")  # IMUs that come with the package
    num_sensors: int = 64  # IMUs of each kind, each with noise of its own, >= 2
    num_samples: int = 16384  # Samples of each record
    seed: int = 0  # Seed of the noise

    def run(self) -> int:
        """Measure, draw and print; return the exit status."""
        results: dict[str, tuple[ImuCfg, AllanRecord, AllanRecord]] = {}
        rows = []
        for number, name in enumerate(self.imu):
            cfg, seed = IMUS.get(name), self.seed + 2 * number
            both = fast_and_slow_records(cfg, num_sensors=self.num_sensors, num_samples=self.num_samples, seed=seed)
            results[name] = (cfg, *both)
            rows += compare_densities(name, cfg, *both)
        self.out.mkdir(parents=True, exist_ok=True)
        draw_deviations(results, self.out / "imu_allan.png")
        print(rows_table(rows))
        return 0


def rows_table(rows: list[AllanRow]) -> str:
    """Return the table of configured and measured figures."""
    heads = ("IMU", "axis", "N configured", "N found [95 %]", "K configured", "K found [95 %]")
    cells = (
        *("`{imu}`", "{sensor} {axis}"),
        *("{noise_configured:.4g}", "{noise_found:.4g} [{noise_low:.4g}, {noise_high:.4g}]"),
        *("{walk_configured:.3g}", "{walk_found:.3g} [{walk_low:.3g}, {walk_high:.3g}]"),
        *("{lowest_configured:.3g} at {lowest_at_s:.3g} s", "{lowest_found:.3g} [{lowest_low:.3g}, {lowest_high:.3g}]"),
    )
    lines = ([cell.format(**row) for cell in cells] for row in rows)
    return table((*heads, "lowest configured", "lowest found"), lines)


def draw_deviations(result: dict[str, tuple[ImuCfg, AllanRecord, AllanRecord]], path: Path) -> None:
    """Draw the deviation of every IMU, its scatter and its two lines, into an image file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, first in zip(figure.subplots(1, 2), (0, 3), strict=True):
        kind = CHANNELS[first][0]
        for color, (name, (cfg, *both)) in zip(("C0", "C1", "C2"), result.items(), strict=False):
            _draw_channel(axes, name, color, channel_densities(cfg)[first], both, first)
        axes.plot([], [], "k--", linewidth=0.8, label="configured N / sqrt(tau)")
        axes.plot([], [], "k:", linewidth=0.8, label="configured K sqrt(tau / 3)")
        axes.set_xlabel("averaging time tau [s]")
        axes.set_ylabel(f"Allan deviation, {kind} x [{UNITS[kind]}]")
        axes.grid(visible=True, which="major", linewidth=0.3)
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=80)


def _draw_channel(
    axes: "Axes", name: str, color: str, density: tuple[float, float], both: Sequence[AllanRecord], channel: int
) -> None:
    for record, label in zip(both, (f"{name}, simulated", None), strict=True):
        signal, style = record.deviation[:, :, channel], {"markersize": 2.5, "linewidth": 0.8, "label": label}
        axes.loglog(record.tau, signal.square().mean(1).sqrt(), "o-", color=color, **style)
        low, high = signal.quantile(torch.tensor([0.05, 0.95], dtype=signal.dtype), dim=1)
        axes.fill_between(record.tau, low, high, color=color, alpha=0.2)
    tau = torch.cat([record.tau for record in both]).sort().values
    noise, walk = density
    lowest = 0.5 * sqrt(2.0 * noise * walk / sqrt(3.0))
    for line, style in ((noise / tau.sqrt(), "--"), (walk * (tau / 3.0).sqrt(), ":")):
        shown = line > lowest
        axes.loglog(tau[shown], line[shown], style, color=color, linewidth=0.8)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(ImuAllanCmd).run())
