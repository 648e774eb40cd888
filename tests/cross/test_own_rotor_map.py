"""A rotor map of a user's own package: the one of the guide, in torch only, on both backends and in the closed loop."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from aerial_gym.physics import ROTOR_MAPS, RotorMap, TorchBackend, WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, state_for_thrust
from tests.cross.test_backends import assert_same_flight
from tests.physics.vehicles import F64, asymmetric_robot, random_state
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, verdict_of_command

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "own_rotor_map.md"
POWER, COEFFICIENT = 2.15, 4.0e-7


@pytest.fixture
def power_law(own_registries: None) -> type[RotorMap]:
    """Return the class of the guide's map, registered for one test."""
    block = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)[0]
    assert "warp" not in block
    names: dict[str, Any] = {"__name__": "own_rotor_map"}
    exec(block, names)
    return names["PowerLaw"]


def with_power_law(robot: RobotCfg, **changes: Any) -> RobotCfg:
    rotor = replace(robot.the_rotor("the test"), rotor_map="power_law", thrust_map=(COEFFICIENT, 0.0, 0.0))
    return replace(robot, rotor=replace(rotor, torque_map=None, torque_ratio=0.015, **changes))


@pytest.mark.parametrize("low", [0.05, -5.0])
def test_thrust_torque_and_inverse_are_those_of_the_power_law(power_law: type[RotorMap], low: float) -> None:
    """``T = c w^p``, odd for a reversible rotor; its drag torque is the ratio times that."""
    vehicle = vehicle_from_config(with_power_law(ROBOT, thrust_range=(low, 5.0)), num_envs=1, dtype=F64)
    speed = torch.tensor([[300.0, 700.0, 1200.0, 900.0]], dtype=F64)
    if low < 0.0:
        speed[0, 1] *= -1.0
    expected = COEFFICIENT * speed.sign() * speed.abs() ** POWER
    torch.testing.assert_close(rotor_thrust(vehicle, speed), expected, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(rotor_torque(vehicle, speed), 0.015 * expected, rtol=1e-12, atol=0.0)
    torch.testing.assert_close(state_for_thrust(vehicle, expected), speed, rtol=1e-12, atol=0.0)
    assert float(vehicle.speed_high[0, 0]) == pytest.approx((5.0 / COEFFICIENT) ** (1.0 / POWER))


@pytest.mark.parametrize("low", [0.05, -5.0])
@pytest.mark.parametrize("controller", ["lee_velocity_control", "rotor_speed_control"])
def test_backends_agree_on_a_user_map(power_law: type[RotorMap], low: float, controller: str) -> None:
    robot = with_power_law(asymmetric_robot(), thrust_range=(low, 8.0))
    effects = ("thrust_coefficient", "ground_effect", "h_force_flapping")
    assert_same_flight(robot, CONTROLLERS.get(controller), "rk4", effects=effects)


def test_gradients_of_both_backends_agree(power_law: type[RotorMap]) -> None:
    """Of the height after a step, by the commanded thrusts: through the inverse map, the lag and the map."""
    start, slopes = random_state(3, seed=4, rotor_speed=800.0), []
    for backend in (TorchBackend(), WarpBackend(differentiable=True)):
        vehicle = vehicle_from_config(with_power_law(ROBOT), num_envs=3)
        law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
        backend.allocate(build_model(vehicle), law, integrator="rk4")
        action = torch.full((3, 4), 1.4, requires_grad=True)
        state = replace(start, **{name: rows.float() for name, rows in vars(start).items()})
        end = backend.advance(state, action, 0.01, 5)
        slopes += torch.autograd.grad(end.position[:, 2].sum(), action)
    assert float(slopes[0].abs().min()) > 0.0
    torch.testing.assert_close(slopes[1], slopes[0], rtol=1e-3, atol=1e-7)


def test_closed_loop_finds_an_error_of_its_coefficient(power_law: type[RotorMap], tmp_path: Path) -> None:
    """The vehicle has 5 % more thrust than the file says."""
    tables = [with_power_law_speeds(flight(70 + seed, seconds=6.0, rate=100.0, noise=1.0)) for seed in range(3)]
    effects = ("--effects", "thrust_coefficient", "rotor_drag")
    (effect,) = verdict_of_command(tmp_path, with_power_law(ROBOT), tables, *effects)["effects"]
    assert effect["name"] == "thrust_coefficient"
    low, high = effect["interval"]["scale"]
    assert low < 1.05 < high
    assert high - low < 0.02


def with_power_law_speeds(table: pd.DataFrame) -> pd.DataFrame:
    """Return a log with the rotor speeds of a vehicle with 1.05 times the declared coefficient."""
    names = [f"rotor_{number}" for number in range(1, 5)]
    thrust = 1.2e-6 * table[names] ** 2
    return table.assign(**{name: (thrust[name] / (1.05 * COEFFICIENT)) ** (1.0 / POWER) for name in names})


def test_a_wrong_inverse_is_refused(power_law: type[RotorMap]) -> None:
    class WrongInverse(power_law):  # type: ignore[misc, valid-type]
        name = "wrong_inverse"

        def speed_for_thrust(self, coefficients: torch.Tensor, thrust: torch.Tensor) -> torch.Tensor:
            return (thrust / coefficients[..., 0]).clamp_min(0.0).sqrt()

    ROTOR_MAPS.register("wrong_inverse", WrongInverse())
    robot = with_power_law(ROBOT)
    robot = replace(robot, rotor=replace(robot.rotor, rotor_map="wrong_inverse"))
    assert_refused(ConfigError, r"wrong_inverse.*speed_for_thrust", vehicle_from_config, robot, num_envs=1)


def test_an_unknown_map_and_two_maps_are_refused(power_law: type[RotorMap]) -> None:
    robot = with_power_law(ROBOT)
    with pytest.raises(UnknownNameError, match="power_low.*power_law"):
        vehicle_from_config(replace(robot, rotor=replace(robot.rotor, rotor_map="power_low")), num_envs=1)
    kinds = {"a": robot.rotor, "b": ROBOT.rotor}
    mounts = tuple(replace(mount, rotor="ab"[i % 2]) for i, mount in enumerate(robot.mounts.layout))
    mixed = replace(robot, rotor=None, rotors=kinds, mounts=replace(robot.mounts, layout=mounts))
    assert_refused(ConfigError, "polynomial, power_law", vehicle_from_config, mixed, num_envs=1)


def test_code_that_no_kernel_can_run_is_refused_with_its_place(power_law: type[RotorMap]) -> None:
    class SpeedSort(power_law):  # type: ignore[misc, valid-type]
        name = "speed_sort"

        def terms(self, speed: torch.Tensor) -> tuple[torch.Tensor, ...]:
            return (speed.sort(-1).values.pow(self.exponent),)

    ROTOR_MAPS.register("speed_sort", SpeedSort())
    robot = with_power_law(ROBOT)
    vehicle = vehicle_from_config(replace(robot, rotor=replace(robot.rotor, rotor_map="speed_sort")), num_envs=2)
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81)
    with pytest.raises(CapabilityError, match=r"speed_sort: .*sort.*test_own_rotor_map\.py:\d+"):
        WarpBackend().allocate(build_model(vehicle), law, integrator="euler")
