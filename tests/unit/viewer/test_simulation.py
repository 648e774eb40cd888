"""A flight as the page changes it, and what the page is told of it."""

import numpy as np
import pytest
import torch

from aerial_gym.env_manager import SimBuilder
from aerial_gym.errors import ConfigError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.task import task_registry
from aerial_gym.viewer.effects import OFFERED, EffectSwitch, add_neutral_effects, effect_forces
from aerial_gym.viewer.simulation import FlightInView, constant_pilot


def make_flight(controller: str = "lee_position_control", robot: str = "base_quadrotor") -> FlightInView:
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="empty_env", robot_name=add_neutral_effects(robot_by_name(robot)),
        controller_name=controller, num_envs=2, device="cpu", seed=0, backend="torch",
    )  # fmt: skip
    return FlightInView(env)


@pytest.fixture(scope="module")
def flight() -> FlightInView:
    return make_flight()


def position(flight: FlightInView, row: int = 0) -> np.ndarray:
    return flight.env.gtd["robot_position"][row].numpy().copy()


def switch(flight: FlightInView, name: str) -> EffectSwitch:
    return next(each for each in flight.effects if each.effect.name == name)


def test_vehicle_follows_its_goal_and_no_other_does(flight: FlightInView) -> None:
    flight.reset()
    start, other = position(flight), position(flight, 1)
    goal = start + np.array([0.5, -0.3, 0.2], dtype=np.float32)
    flight.move_goal(tuple(goal.tolist()))
    for _ in range(400):
        flight.step()
    assert np.linalg.norm(position(flight) - goal) < 0.05
    assert np.linalg.norm(position(flight, 1) - other) < 0.05
    shown = flight.snapshot().goal
    assert shown is not None
    np.testing.assert_allclose(shown, goal, atol=1e-6)


def test_push_changes_the_velocity_of_the_chosen_vehicle(flight: FlightInView) -> None:
    flight.reset()
    flight.chosen = 1
    before = flight.env.gtd["robot_linvel"].clone()
    flight.push((0.0, 1.5, 0.0))
    expected = before + torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
    torch.testing.assert_close(flight.env.gtd["robot_linvel"], expected)
    flight.chosen = 0


def test_pointer_pulls_the_vehicle(flight: FlightInView) -> None:
    flight.reset()
    start = position(flight)
    flight.pull = start + np.array([2.0, 0.0, 0.0], dtype=np.float32)
    for _ in range(50):
        flight.step()
    flight.pull = None
    assert position(flight)[0] > start[0] + 0.2


def test_sticks_fly_the_chosen_vehicle_alone() -> None:
    flight = make_flight("lee_velocity_control")
    start = position(flight), position(flight, 1)
    flight.sticks[0], flight.by_hand = 0.5, True
    for _ in range(100):
        flight.step()
    assert position(flight)[0] > start[0][0] + 0.4
    assert np.linalg.norm(position(flight, 1) - start[1]) < 0.2


@pytest.mark.parametrize("controller", ["rotor_speed_control", "no_control"])
def test_commands_of_rotors_rest_at_hover(controller: str) -> None:
    flight = make_flight(controller)
    flight.env.robot_manager.tensors.state.lin_vel.zero_()
    flight.env.robot_manager.tensors.state.ang_vel.zero_()
    flight.step()
    assert abs(float(flight.env.gtd["robot_linvel"][0, 2])) < 0.01


def test_vehicle_far_outside_its_room_begins_anew(flight: FlightInView) -> None:
    flight.reset()
    flight.env.robot_manager.tensors.state.position[1, 0] += 100.0
    flight.step()
    assert position(flight, 1)[0] < 50.0
    assert flight.env.gtd["episodes"].tolist()[1] == flight.env.gtd["episodes"].tolist()[0] + 1


def test_switch_writes_its_parameters_and_the_neutral_ones(flight: FlightInView) -> None:
    wind = switch(flight, "constant_wind")
    wind.values, wind.is_on = [3.0, 0.0, -1.0], True
    wind.apply()
    assert flight.env.gtd["effect_constant_wind"].tolist() == [[3.0, 0.0, -1.0]] * 2
    wind.is_on = False
    wind.apply()
    assert flight.env.gtd["effect_constant_wind"].tolist() == [[0.0, 0.0, 0.0]] * 2


def test_forces_are_those_of_the_laws(flight: FlightInView) -> None:
    """Drag is ``-d (v - w)`` upright; wind changes it by ``d w``; a payload adds the weight ``-dm g``."""
    flight.reset()
    state, drag, wind = flight.env.robot_manager.tensors.state, 0.2, torch.tensor([3.0, 0.0, 0.0])
    for name, values in (("rotor_drag", [drag] * 3), ("constant_wind", wind.tolist()), ("payload_mass", [0.05])):
        each = switch(flight, name)
        each.values, each.is_on = values, True
        each.apply()
    flight.step()
    state.lin_vel[0] = torch.tensor([1.0, 2.0, 0.0])
    state.attitude[0], state.ang_vel[0] = torch.tensor([0.0, 0.0, 0.0, 1.0]), torch.zeros(3)
    forces = effect_forces(flight.env, 0)
    for each in flight.effects:
        each.is_on = False
        each.apply()
    assert forces.keys() == {"rotor_drag", "constant_wind", "payload_mass"}
    np.testing.assert_allclose(forces["rotor_drag"], -drag * (state.lin_vel[0] - wind), atol=1e-5)
    np.testing.assert_allclose(forces["constant_wind"], drag * wind, atol=1e-5)
    np.testing.assert_allclose(forces["payload_mass"], [0.0, 0.0, -0.05 * 9.81], atol=1e-3)
    flight.step()
    assert effect_forces(flight.env, 0) == {}


def test_task_shows_target_and_reads_every_vehicle() -> None:
    task = task_registry.make_task("position_setpoint_task", num_envs=3, device="cpu", seed=0)
    flight = FlightInView(task.env, task, constant_pilot(task))
    flight.chosen = 2
    flight.move_goal((0.5, 0.0, 0.25))
    flight.step()
    snapshot = flight.snapshot()
    assert snapshot.goal is not None
    assert snapshot.goal.tolist() == [0.5, 0.0, 0.25]
    assert snapshot.chosen == 2
    np.testing.assert_array_equal(snapshot.position, task.env.gtd["robot_position"].numpy())
    assert snapshot.time == pytest.approx(task.env.dt)
    assert flight.content.robot == task.env.robot_manager.cfg


@pytest.mark.parametrize("name", ["morphy", "snakey5", "bluerov2_heavy", "tilt_tricopter"])
def test_offered_effects_that_do_not_suit_are_left_out(name: str) -> None:
    robot = robot_by_name(name)
    added = add_neutral_effects(robot).effects.keys() - robot.effects.keys()
    assert added <= set(OFFERED)


def test_named_effect_that_does_not_suit_is_refused() -> None:
    """Drag of links needs joints."""
    with pytest.raises(ConfigError, match="link_drag"):
        add_neutral_effects(robot_by_name("base_quadrotor"), ["link_drag"])


def test_neutral_effects_change_nothing_and_switched_ones_do(flight: FlightInView) -> None:
    for each in flight.effects:
        assert not each.is_on
        assert tuple(each.values) != each.neutral
        rows = flight.env.gtd[f"effect_{each.effect.name}"]
        assert rows.tolist() == [pytest.approx(each.neutral)] * 2
        for number, parameter in enumerate(each.effect.parameters):
            low, high = each.limits(number)
            assert parameter.low <= low <= each.values[number] <= high <= parameter.high
