"""Allan deviation of a signal: the scatter of averages over a time tau, which separates noise from bias drift.

White noise of density N gives ``N / sqrt(tau)``, a bias that walks by K per sqrt(s) gives ``K sqrt(tau / 3)``.
``python -m benchmarks.devices.imu_allan`` compares both with the simulated IMUs.
Source: IEEE Std 952-1997, annexes B and C; El-Sheimy, Hou, Niu (2008), Analysis and Modeling of Inertial Sensors Using Allan
Variance, IEEE Trans. Instrumentation and Measurement 57(1).
Letters: T samples, K averaging times, S sensors.
"""

import torch
from torch import Tensor

from aerial_gym.config.imu import ImuCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ShapeError
from aerial_gym.math.random import Randomness
from aerial_gym.sensors.imu import Imu


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
