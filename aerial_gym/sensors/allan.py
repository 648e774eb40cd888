"""Allan deviation: how much averages over a time tau scatter, and what that says of noise and bias.

White noise of density N gives ``N / sqrt(tau)``, a bias that walks by K per sqrt(s) gives ``K sqrt(tau / 3)``.
``python -m aerial_gym.sensors.allan --imu vn100 --out allan.png`` draws both lines beside what the simulated IMU does.
Source: IEEE Std 952-1997, annexes B and C; El-Sheimy, Hou, Niu (2008), Analysis and Modeling of Inertial Sensors Using Allan
Variance, IEEE Trans. Instrumentation and Measurement 57(1).
Letters: T samples, K averaging times, S sensors.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.config.console import accept_any_console
from aerial_gym.config.imu import ImuCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import AerialGymError, ShapeError
from aerial_gym.math.random import Randomness
from aerial_gym.sensors.catalog import IMUS
from aerial_gym.sensors.imu import Imu

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def allan_deviation(samples: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Return averaging times and the overlapping estimate of the Allan deviation there.

    With the integral theta of the signal, ``sigma²(tau) = <(theta(t + 2 tau) - 2 theta(t + tau) + theta(t))²> / (2 tau²)``.

    Args:
        samples: One signal per column, (T, ...), T >= 2.
        dt: Time between samples [s].

    Returns:
        Averaging times m dt [s] for m = 1, 2, 4, ... up to T / 2, float64, (K,), and the deviation in the unit of the signal,
        float64, (K, ...). Of one signal its relative error is about ``1 / sqrt(2 (T / m - 1))``.

    Raises:
        ShapeError: If there are fewer than two samples.
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
    """Return what IMUs that lie still and level measure [m/s², rad/s], every ``dt`` [s], float32, (T, S, 6)."""
    attitude = torch.zeros(num_sensors, 4)
    attitude[:, 3] = 1.0
    still, measurement = torch.zeros(num_sensors, 3), torch.zeros(num_sensors, 6)
    random, every = Randomness(num_sensors, seed=seed), torch.ones(num_sensors, dtype=torch.bool)
    imu = Imu(
        cfg,
        attitude=attitude,
        lin_vel=still,
        ang_vel=still,
        measurement_out=measurement,
        dt=dt,
        gravity=STANDARD_GRAVITY,
        random=random,
    )
    random.begin(every)
    imu.reset(every)
    samples = torch.empty(num_samples, num_sensors, 6)
    for row in samples:
        imu.measure()
        row.copy_(measurement)
    return samples


def plot_allan(cfg: ImuCfg, path: str | Path, *, rate_hz: float = 10.0, duration_s: float = 7200.0) -> None:
    """Draw the Allan deviation of a simulated IMU beside the lines of its configuration, into an image file."""
    from matplotlib.figure import Figure

    samples = record_at_rest(cfg, num_sensors=1, num_samples=int(duration_s * rate_hz), dt=1.0 / rate_hz, seed=0)
    tau, deviation = allan_deviation(samples[:, 0], 1.0 / rate_hz)
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    panels = figure.subplots(1, 2)
    _draw(panels[0], "accelerometer [m/s²]", tau, deviation[:, :3], cfg.accel_noise_density, cfg.accel_bias_walk)
    _draw(panels[1], "gyro [rad/s]", tau, deviation[:, 3:], cfg.gyro_noise_density, cfg.gyro_bias_walk)
    figure.suptitle(f"{cfg.summary}: {duration_s:g} s at {rate_hz:g} Hz", fontsize=10)
    figure.savefig(path, dpi=120)


def _draw(
    axes: "Axes", name: str, tau: Tensor, deviation: Tensor, noise: tuple[float, ...], walk: tuple[float, ...]
) -> None:
    for axis, column, n, k, color in zip("xyz", deviation.T, noise, walk, ("C0", "C1", "C2"), strict=True):
        axes.loglog(tau, column, "o-", color=color, markersize=3, linewidth=0.8, label=f"{axis}, simulated")
        axes.loglog(tau, n / tau.sqrt(), "--", color=color, linewidth=0.8)
        axes.loglog(tau, k * (tau / 3.0).sqrt(), ":", color=color, linewidth=0.8)
    axes.plot([], [], "k--", linewidth=0.8, label="configured N / sqrt(tau)")
    axes.plot([], [], "k:", linewidth=0.8, label="configured K sqrt(tau / 3)")
    axes.set_ylim(0.3 * float(deviation.min()), 3.0 * float(deviation.max()))
    axes.set_xlabel("averaging time tau [s]")
    axes.set_ylabel(f"Allan deviation, {name}")
    axes.grid(visible=True, which="both", linewidth=0.3)
    axes.legend(fontsize=7)


@dataclass(frozen=True, kw_only=True)
class AllanCmd:
    """Draw the Allan deviation of a simulated IMU beside the lines of its configuration."""

    imu: str
    """Name of an IMU that comes with the package."""

    out: Path
    """Image to write."""

    rate_hz: float = 10.0
    """Samples per second."""

    duration_s: float = 7200.0
    """Length of the record [s]."""

    def run(self) -> int:
        """Write the image and print its path; return the exit status."""
        try:
            plot_allan(IMUS.get(self.imu), self.out, rate_hz=self.rate_hz, duration_s=self.duration_s)
        except AerialGymError as error:
            print(error, file=sys.stderr)
            return 2
        print(self.out)
        return 0


if __name__ == "__main__":
    import tyro

    accept_any_console()

    sys.exit(tyro.cli(AllanCmd).run())
