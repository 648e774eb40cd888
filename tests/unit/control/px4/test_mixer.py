"""What gives way where PX4's motors are at their limits: numbers of its unit tests, and what the integral is told.

PX4's own code is laid beside it in ``tests/cross/test_px4.py``.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.autopilots import Px4Cfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.px4.cascade import MixerOutput, mix
from aerial_gym.errors import ConfigError
from aerial_gym.physics import state_at_rest, vehicle_from_config
from aerial_gym.physics.law_memory import fresh_law_memory
from aerial_gym.robots import ROBOTS

F64 = torch.float64
UNIT_TEST = torch.tensor(
    [[0.25, 0.25, 5, 0.25], [-0.25, -0.25, 5, 0.25], [-0.25, 0.25, -5, 0.25], [0.25, -0.25, -5, 0.25]]
)
"""The mixing matrix of PX4's unit tests: a quadrotor of 1 m by 1 m and a moment ratio of 0.05, not normalised."""

QUADROTOR = UNIT_TEST / torch.tensor([0.25 * 2**0.5, 0.25 * 2**0.5, 5.0, 0.25])
"""The same, normalised."""


def mix_row(wanted: list[float], airmode: int, columns: Tensor = QUADROTOR, *, low: float = 0.0) -> MixerOutput:
    rows = columns.to(F64).unsqueeze(0)
    return mix(rows, torch.tensor([wanted], dtype=F64), torch.full(rows.shape[:2], low, dtype=F64), airmode=airmode)


@pytest.mark.parametrize(("wanted", "airmode", "short"), [
    ([0.1, -0.1, 0.1, 0.5], 0, [0, 0, 0]),
    ([-0.4, 0.0, 0.0, 0.1], 0, [-1, 0, 0]),
    ([-0.4, 0.0, 0.0, 0.1], 1, [0, 0, 0]),
    ([0.0, 0.0, -0.4, 0.1], 1, [0, 0, -1]),
    ([0.0, 0.0, -0.4, 0.1], 2, [0, 0, 0]),
    ([0.0, 1.2, 0.1, 0.5], 1, [0, 1, 1]),
])  # fmt: skip
def test_it_tells_which_torque_is_not_given(wanted: list[float], airmode: int, short: list[int]) -> None:
    torch.testing.assert_close(mix_row(wanted, airmode).short, torch.tensor([short], dtype=F64))


@pytest.mark.parametrize("airmode", [0, 1, 2])
def test_lost_torque_is_that_of_least_squares(airmode: int) -> None:
    """Six random motors: torque that NumPy finds in the signals; all of it is lost where a motor was clamped."""
    rng = np.random.default_rng(airmode)
    columns, wanted = rng.uniform(-1.0, 1.0, (300, 6, 4)), rng.uniform(-0.6, 0.6, (300, 4))
    columns[..., 3] = rng.uniform(0.5, 1.0, (300, 6))
    low = np.full((300, 6), 0.05)
    output = mix(*(torch.from_numpy(rows) for rows in (columns, wanted, low)), airmode=airmode)
    clamped = 0
    for column, command, signal, short in zip(columns, wanted, output.signal.numpy(), output.short, strict=True):
        given, residual, *_ = np.linalg.lstsq(column, signal, rcond=None)
        whole = residual[0] < 1e-16
        clamped += not whole
        lost = command[:3] - given[:3] * whole
        assert short.tolist() == np.where(np.abs(lost) > 1e-6, np.sign(lost), 0.0).tolist()
    assert 20 < clamped < 280


def test_the_integral_waits_for_the_torque_that_airmode_would_give() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("x500"), num_envs=1, dtype=F64)
    grown = []
    for airmode in (0, 1):
        px4 = Px4Cfg(MC_ROLLRATE_P=0.5, MC_ROLLRATE_I=0.5, MC_RR_INT_LIM=10.0, MC_AIRMODE=airmode)
        law = make_controller(replace(CONTROLLERS.get("px4_rate_control"), px4=px4), vehicle, 9.81, dt=0.002)
        state, memory = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64), None
        memory = fresh_law_memory(law.needs, 1, state.position)
        for _ in range(10):
            _, memory = law.command(state, torch.tensor([[-0.95, 0.3, 0.0, 0.0]], dtype=F64), memory)
        grown.append(float(memory.numbers[0, 0]))
    assert grown[1] == pytest.approx(10.0 * grown[0])  # told one run late


def test_another_airmode_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"MC_AIRMODE = 3: must be 0, 1 or 2"):
        Px4Cfg(MC_AIRMODE=3)
