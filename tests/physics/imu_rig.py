"""An IMU on a body that is moved by hand, for tests."""

from dataclasses import replace
from math import nan

import torch
from torch import Tensor

from aerial_gym.config.sensor import ImuCfg
from aerial_gym.math.quaternion import quat_exp, quat_from_euler, quat_multiply, quat_rotate_inverse
from aerial_gym.math.random import Randomness
from aerial_gym.sensors.imu import Imu
from aerial_gym.sensors.mounts import Carrier

G = 9.81
ZERO = (0.0, 0.0, 0.0)
IDEAL = ImuCfg(
    summary="without errors", accel_noise_density=ZERO, gyro_noise_density=ZERO, accel_bias_walk=ZERO,
    gyro_bias_walk=ZERO, accel_initial_bias=ZERO, gyro_initial_bias=ZERO, accel_range=1e6, gyro_range=1e6,
    source="test",
)  # fmt: skip
NOISY = replace(
    IDEAL, misalignment_deg=(1.0, 2.0, 3.0), accel_noise_density=(0.01, 0.02, 0.03),
    gyro_noise_density=(0.001, 0.002, 0.003), accel_bias_walk=(0.1, 0.2, 0.3), gyro_bias_walk=(0.01, 0.02, 0.03),
    accel_initial_bias=(0.5, 0.6, 0.7), gyro_initial_bias=(0.1, 0.2, 0.3),
)  # fmt: skip


class ImuRig:
    """An IMU on a body that is moved by hand. Everything it writes is NaN beforehand."""

    def __init__(
        self, cfg: ImuCfg, num_envs: int = 1, *, dt: float = 0.01, seed: int = 0, errors=None, pose=None
    ) -> None:
        self.attitude = torch.zeros(num_envs, 4)
        self.attitude[:, 3] = 1.0
        self.lin_vel, self.ang_vel = torch.zeros(num_envs, 3), torch.zeros(num_envs, 3)
        self.measurement = torch.full((num_envs, 6), nan)
        self.all = torch.ones(num_envs, dtype=torch.bool)
        self.random = Randomness(num_envs, seed=seed)
        self.imu = Imu(
            cfg, Carrier(position=self.lin_vel, attitude=self.attitude, lin_vel=self.lin_vel, ang_vel=self.ang_vel),
            measurement_out=self.measurement, dt=dt, gravity=G, random=self.random, errors=errors, pose=pose,
        )  # fmt: skip
        for name, tensor in self.imu.state_tensors().items():
            if name not in ("sample", "steps", "place"):
                tensor.fill_(nan)

    def reset(self) -> Tensor:
        self.random.begin(self.all)
        self.imu.reset(self.all)
        return self.measurement

    def sample(self, attitude: Tensor, lin_vel: Tensor, ang_vel: Tensor) -> Tensor:
        """Return the sample (E, 6) at a new state."""
        self.move(attitude, lin_vel, ang_vel)
        self.imu.measure()
        return self.measurement

    def move(self, attitude: Tensor, lin_vel: Tensor, ang_vel: Tensor) -> None:
        self.attitude.copy_(attitude)
        self.lin_vel.copy_(lin_vel)
        self.ang_vel.copy_(ang_vel)

    def memory(self) -> list[Tensor]:
        state = self.imu.state_tensors()
        line, drawn = state.pop("line"), [state.pop(name) for name in ("bias", "mount_attitude")]
        return [self.measurement, *drawn, *state.values(), *line]


def spin_about_z(rig: ImuRig, samples: int, rate: float, growth: float) -> list[Tensor]:
    """Return the samples of a body whose origin rests and which turns about z with ``w = rate + growth t``."""
    result = []
    rig.move(quat_from_euler(torch.zeros(1, 3)), torch.zeros(1, 3), torch.tensor([[0.0, 0.0, rate]]))
    rig.reset()
    for k in range(1, samples + 1):
        t = 0.01 * k
        turn = torch.tensor([[0.0, 0.0, rate * t + 0.5 * growth * t * t]])
        rate_now = torch.tensor([[0.0, 0.0, rate + growth * t]])
        result.append(rig.sample(quat_from_euler(turn), torch.zeros(1, 3), rate_now).clone())
    return result


def wobble(t: Tensor, r: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return attitude, velocity, angular velocity and the specific force at r of a smooth motion at times t (E,), float64.
    The body turns about a fixed, tilted axis n by ``theta = 3 t + sin(4 t)``, its origin moves as
    ``v = (sin 5t, cos 3t, t²)``. Closed form: ``f = R^T (a_o + g z) + theta'' n x r + theta'² n x (n x r)``."""
    t = t.double().unsqueeze(-1)
    n = torch.tensor([2.0, -1.0, 2.0], dtype=torch.float64).expand(len(t), 3) / 3.0
    start = quat_from_euler(torch.tensor([0.4, -0.6, 1.1], dtype=torch.float64)).expand(len(t), 4)
    attitude = quat_multiply(start, quat_exp((3.0 * t + torch.sin(4.0 * t)) * n))
    rate, acceleration = 3.0 + 4.0 * torch.cos(4.0 * t), -16.0 * torch.sin(4.0 * t)
    velocity = torch.cat((torch.sin(5.0 * t), torch.cos(3.0 * t), t * t), dim=-1)
    felt = torch.cat((5.0 * torch.cos(5.0 * t), -3.0 * torch.sin(3.0 * t), 2.0 * t + G), dim=-1)
    lever = torch.linalg.cross(n, r.double().expand_as(n))
    force = quat_rotate_inverse(attitude, felt) + acceleration * lever + rate**2 * torch.linalg.cross(n, lever)
    return attitude, velocity, rate * n, force
