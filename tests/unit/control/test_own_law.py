"""A control law of a user's own package: the one of the guide, without Warp code, on both backends."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import physics
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROL_LAWS, CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.hover import hover_action, trim_axes
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import check_robot
from aerial_gym.robots.check.flights import StableStep, largest_stable_step
from tests.physics.vehicles import random_state
from tests.refusals import assert_refused

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "own_law.md"
ROBOT, DT = ROBOTS.get("base_quadrotor"), 0.004


@pytest.fixture
def own_law(own_registries: None) -> str:
    """Return the name of the guide's controller, registered for one test."""
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert "warp" not in blocks[0]
    names: dict[str, Any] = {"__name__": "own_law"}
    exec(blocks[0], names)
    return "climb_rate_control"


def test_an_own_law_flies_alike_on_both_backends(own_law: str) -> None:
    """At its own rate, with delayed actions, from random states, 40 steps; some rotors reach their limits."""
    cfg = replace(CONTROLLERS.get(own_law), rate_hz=50.0, action_delay=0.02)
    start, ends = random_state(8, seed=3, rotor_speed=400.0), []
    for backend in (physics.TorchBackend(), physics.WarpBackend()):
        vehicle = physics.vehicle_from_config(ROBOT, num_envs=8)
        backend.allocate(physics.build_model(vehicle), make_controller(cfg, vehicle, 9.81, dt=DT), integrator="euler")
        state = physics.BodyState(**{name: rows.float() for name, rows in vars(start).items()})
        backend.step(state, torch.tensor([[0.5, 0.3, -0.2, 0.1]]).repeat(8, 1), DT, 40)
        ends.append(state)
    for name, rows in vars(ends[0]).items():
        torch.testing.assert_close(getattr(ends[1], name), rows, rtol=1e-4, atol=1e-4, msg=name)


def test_its_integral_carries_an_unknown_load(own_law: str) -> None:
    """With a vehicle 20 % heavier than declared it climbs as commanded; ``4 I = 0.2 g`` is what the integral then carries."""
    declared = physics.vehicle_from_config(ROBOT, num_envs=1)
    law, backend = make_controller(CONTROLLERS.get(own_law), declared, 9.81, dt=DT), physics.WarpBackend()
    backend.allocate(
        physics.build_model(replace(declared, mass=declared.rows_for_all_envs(1.2 * declared.mass[0]))),
        law,
        integrator="euler",
    )
    state = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=torch.float32)
    backend.step(state, torch.tensor([[0.5, 0.0, 0.0, 0.0]]), DT, 4000)
    assert float(state.lin_vel[0, 2]) == pytest.approx(0.5, abs=1e-3)
    assert backend.law_memory is not None
    assert float(backend.law_memory.numbers[0, 0]) == pytest.approx(0.05 * 9.81, abs=2e-3)


def check(dt: float, law: str = "climb_rate_control", **changes: Any) -> None:
    controller = replace(CONTROLLERS.get(law), **changes)
    check_closed_loop(ROBOT, controller, gravity=9.81, dt=dt, integrator="rk4", names=("quad", law))


def test_the_check_before_flight_refuses_an_own_law_at_a_long_time_step(own_law: str) -> None:
    """Body rates with a gain of 20/s and a rotor lag are stable at 4 ms, and not when they run only each 0.2 s."""
    check(DT)
    assert_refused(ConfigError, r"grows by a factor.*climb_rate", check, 0.2)
    assert_refused(ConfigError, "grows by a factor", check, DT, rate_hz=5.0)


def test_robot_check_finds_the_largest_time_step_of_an_own_law(own_law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flights in the physics backend come to rest up to that step, and the linear loop is unstable well above."""
    controller = CONTROLLERS.get(own_law)
    step = largest_stable_step(ROBOT, controller, name=own_law)
    assert step.refused is None
    assert step.largest_s is not None
    loop = ClosedLoop(ROBOT, controller, gravity=9.81, integrator="euler", names=("quad", own_law))
    assert loop.is_stable_with_margin(step.largest_s)
    assert loop.spectral_radius(4.0 * step.largest_s) > 1.0
    report_module = "aerial_gym.robots.check.report.largest_stable_steps"
    monkeypatch.setattr(
        report_module, lambda _, controllers, **__: [StableStep(controller=name) for name in controllers]
    )
    assert own_law in {each.controller for each in check_robot(ROBOT, name="quad").stable_steps}


def test_a_law_without_trim_is_not_checked_and_says_so(own_law: str, caplog: pytest.LogCaptureFixture) -> None:
    entry = CONTROL_LAWS.get("climb_rate")
    assert trim_axes(CONTROLLERS.get(own_law)) == ("vz", "p", "q", "r")
    del entry.trim  # type: ignore[attr-defined]
    check(0.2)
    assert "states no trim" in caplog.text
    step = largest_stable_step(ROBOT, CONTROLLERS.get(own_law), name=own_law)
    assert "no trim" in (step.refused or "")
    entry.trim = "vz p yawing"  # type: ignore[attr-defined]
    assert_refused(ConfigError, "'yawing' is no axis", check, DT)


def test_an_own_law_states_its_action_at_hover(own_law: str, caplog: pytest.LogCaptureFixture) -> None:
    """A thrust in N is the weight at hover; with 0 the vehicle rests 9.81 m lower, where ``m g = m z``."""

    class ThrustAndRates(CONTROL_LAWS.get("climb_rate")):  # type: ignore[misc]
        action_names = ("thrust [N]", "p [rad/s]", "q [rad/s]", "r [rad/s]", "z [m]")
        trim = "z vz p q r"

        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            self.hover_action = (9.81 * float(self.mass[0]), 0.0, 0.0, 0.0, 0.0)
            self.set_needs(self.timing, num_rotors=4, num_setpoint=4)

        def outer(
            self, state: physics.BodyState, action: Tensor, memory: Tensor, begins: Tensor
        ) -> tuple[Tensor, Tensor]:
            error = action[:, 4:] - state.position[:, 2:] - 1.5 * state.lin_vel[:, 2:]
            return torch.cat((action[:, :1] + self.mass.unsqueeze(-1) * error, action[:, 1:4]), dim=-1), memory

    CONTROL_LAWS.register("thrust_and_rates", ThrustAndRates)
    CONTROLLERS.register("thrust_and_rates", ControllerCfg(summary="thrust and rates", law="thrust_and_rates"))
    check(DT, "thrust_and_rates")
    assert caplog.text == ""
    vehicle = physics.vehicle_from_config(ROBOT, num_envs=1)
    law = make_controller(CONTROLLERS.get("thrust_and_rates"), vehicle, 9.81, dt=DT)
    assert hover_action(law, 2.0).tolist() == pytest.approx([9.81 * ROBOT.body.mass, 0.0, 0.0, 0.0, 2.0])
    assert hover_height("thrust_and_rates") == pytest.approx(0.0, abs=1e-6)
    ThrustAndRates.hover_action = property(lambda law: (), lambda law, value: None)
    assert hover_height("thrust_and_rates") == pytest.approx(-9.81, abs=1e-6)


def hover_height(law: str) -> float:
    """Return the height [m] at which the vehicle rests above its setpoint."""
    loop = ClosedLoop(ROBOT, CONTROLLERS.get(law), gravity=9.81, integrator="rk4", names=("quad", law))
    return float(loop.equilibrium(DT).offset_from_start[0, 2])


def test_an_unknown_law_is_refused_with_the_known_ones(own_law: str) -> None:
    vehicle = physics.vehicle_from_config(ROBOT, num_envs=1)
    with pytest.raises(ConfigError, match=r"ControllerCfg.law = 'climb': unknown. Known: thrust, .*, climb_rate"):
        make_controller(replace(CONTROLLERS.get(own_law), law="climb"), vehicle, 9.81, dt=DT)
    with pytest.raises(ConfigError, match="needs a time step"):
        make_controller(CONTROLLERS.get(own_law), vehicle, 9.81)


class GainLaw:
    """Rotor speeds proportional to the action; it counts its calls."""

    action_names = ("share [-]",)
    calls = 0

    def __init__(self, vehicle: physics.Vehicle, gain: float) -> None:
        self.gain = vehicle.rows_for_all_envs([[gain]])  # (E, 1, 1)

    def rotor_command(self, state: physics.BodyState, action: Tensor) -> Tensor:
        self.calls += 1
        return 500.0 * action.expand(-1, 4) * (1.0 + self.gain[:, 0])


@pytest.mark.parametrize(("gain", "traces"), [(0.5, 1), (0.0, 2)])
def test_a_changed_model_traces_the_law_again_only_if_its_structure_changed(gain: float, traces: int) -> None:
    """A gain of 0 is folded into the kernel; a gain of 0.5 is a number of it, which can change."""
    vehicle, backend = physics.vehicle_from_config(ROBOT, num_envs=2), physics.WarpBackend()
    law, state = GainLaw(vehicle, gain), physics.state_at_rest(2, 4, device=torch.device("cpu"), dtype=torch.float32)
    backend.allocate(physics.build_model(vehicle), law, integrator="euler")
    law.gain[0].fill_(0.25)
    backend.set_model(physics.build_model(replace(vehicle, mass=vehicle.rows_for_all_envs(2.0 * vehicle.mass[0]))))
    assert law.calls == traces
    backend.step(state, torch.full((2, 1), 0.8), DT, 1000)
    torch.testing.assert_close(state.rotor_speed, torch.full((2, 4), 500.0), rtol=1e-5, atol=0.0)
