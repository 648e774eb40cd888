"""Feed-forward and limits of the Crazyflie's laws by hand, for cases that the vectors of the firmware leave out."""

import pytest
import torch

from aerial_gym.control.crazyflie.mellinger import FlatTarget, MellingerGains, mellinger_control
from aerial_gym.control.crazyflie.pid import PidGains, PidLevel, outer_loop
from aerial_gym.physics import state_at_rest

F64 = torch.float64


def run_mellinger(**target: list[float]) -> tuple[list[float], list[float]]:
    """Return thrust and moment in counts at rest and level with an inclination limit; masses and gains are simple numbers."""
    widths = {"mass": 1, "mass_thrust": 1, "rate_difference": 1}
    values = {"mass": 0.5, "mass_thrust": 100.0, "position": 1.0, "rate": 20.0, "attitude": 7.0}
    gains = MellingerGains(
        **{
            name: torch.full((1, widths.get(name, 3)), values.get(name, 0.0), dtype=F64)
            for name in MellingerGains.__annotations__
        }
    )
    rows = {name: torch.tensor([target.get(name, [0.0, 0.0, 0.0])], dtype=F64) for name in FlatTarget.__annotations__}
    flat = FlatTarget(**(rows | {"yaw": torch.zeros(1, dtype=F64)}))
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    thrust, moment, _ = mellinger_control(
        state, flat, torch.zeros(1, 8, dtype=F64), gains, gravity=10.0, dt=0.01, max_inclination=0.5
    )
    return thrust[0].tolist(), moment[0].tolist()


def test_mellinger_feeds_forward_acceleration_and_rates() -> None:
    """Thrust is ``100 m (g + a)``, moment ``20 w`` for wanted rates w of a level vehicle at its target."""
    thrust, moment = run_mellinger(acceleration=[0.0, 0.0, 3.0], rates=[0.1, -0.2, 0.3])
    assert thrust == pytest.approx([650.0])
    assert moment == pytest.approx([2.0, -4.0, 6.0])


def test_mellinger_keeps_a_tenth_of_the_weight_for_a_far_lower_target() -> None:
    assert run_mellinger(position=[0.0, 0.0, -50.0])[0] == pytest.approx([50.0])


def test_the_velocity_setpoint_is_at_most_a_tenth_above_its_limit() -> None:
    """5 m ahead with 10 1/s asks for 50 m/s; the limit of 2 m/s allows 2.2 m/s, and 1 deg s/m makes 2.2 deg of pitch."""
    rows = {name: torch.zeros(1, 3, dtype=F64) for name in PidLevel.__annotations__}
    levels = [PidLevel(**(rows | {"proportional": torch.full((1, 3), gain, dtype=F64)})) for gain in (10.0, 1.0)]
    gains = PidGains(
        position=levels[0], velocity=levels[1], attitude=levels[0], rates=levels[0],
        most_velocity=torch.full((1, 3), 2.0, dtype=F64),
        **{name: torch.full((1, 1), 20.0, dtype=F64) for name in ("most_tilt", "thrust_base", "least_thrust")},
    )  # fmt: skip
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    position = state.position + torch.tensor([[5.0, 0.0, 0.0]], dtype=F64)
    setpoint, _ = outer_loop(state, position, torch.zeros(1, 6, dtype=F64), gains, dt=0.01)
    assert setpoint[0].tolist() == pytest.approx([20.0, 0.0, 2.2])
