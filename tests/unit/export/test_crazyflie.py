"""The Crazyflie controller of a policy, compiled for this machine, against torch; and policies that it cannot fly."""

from dataclasses import replace
from pathlib import Path
from shutil import which

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.export.export import write_policy
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets import crazyflie
from aerial_gym.export.targets.requirements import X_PLACES, rotor_numbers
from tests.engines.crazyflie import build, fly, shares, write_states
from tests.engines.policies import commands, compare, engine_layout, random_states
from tests.unit.export.policies import random_policy

COMPILER = pytest.mark.skipif(which("gcc") is None, reason="needs gcc")
TERMS = tuple(crazyflie.TERMS)
FLIGHT = ("position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body", "policy_action")


@COMPILER
@pytest.mark.parametrize(("terms", "kind", "memory"), [(TERMS, "thrust", 0), (FLIGHT, "speed", 8)])
def test_the_controller_gives_the_forces_of_the_policy(terms, kind, memory, tmp_path: Path) -> None:
    """Every observation term, thrust and speed, with and without a memory: forces by states, as in the simulator."""
    width = sum(len(crazyflie.TERMS[term]) for term in terms)
    policy = random_policy(width, memory=memory)
    policy.head.weight.data *= 0.05  # most actions then lie within the limits
    made, states = engine_layout(policy, terms, kind=kind, scale=0.5), random_states(2_000)
    (result,) = write_policy(policy, made, tmp_path, ["crazyflie"])
    assert result.agrees
    folder = result.file.parent
    write_states(folder, states)
    forces, _ = fly(build(folder, made.name, arm=False), arm=False)
    exact, rounded = (shares(made, commands(policy, made, each)) for each in (states.double(), states))
    assert ((exact > 0.01) & (exact < 0.99)).float().mean() > 0.5
    worst = compare(("M1", "M2", "M3", "M4"), exact, rounded, forces).worst
    assert worst.holds, worst
    assert "alloc" not in "".join(file.read_text() for file in folder.iterdir() if file.suffix in (".c", ".h"))


@COMPILER
@pytest.mark.parametrize(("mode", "bad"), [(0.0, 0.0), (1.0, torch.nan), (1.0, torch.inf)])
def test_motors_stop_without_a_setpoint_or_a_finite_number(mode: float, bad: float, tmp_path: Path) -> None:
    policy = random_policy(19)
    made, states = engine_layout(policy, FLIGHT), random_states(50)
    states.velocity[:, 1] += bad
    folder = write_policy(policy, made, tmp_path, ["crazyflie"], check=False)[0].file.parent
    write_states(folder, states, mode)
    forces, _ = fly(build(folder, made.name, arm=False), arm=False)
    assert torch.equal(forces, torch.zeros(50, 4))


def test_motors_are_in_the_order_of_the_firmware() -> None:
    made = engine_layout(random_policy(19), FLIGHT, robot="x500")  # front right, back left, front left, back right
    assert rotor_numbers(made, crazyflie.MOTORS) == [0, 3, 1, 2]
    assert rotor_numbers(made, X_PLACES) == [0, 3, 1, 2]
    source = crazyflie.controller_source(made)
    assert "force[1] = command[3] * 5.000000000e-02f;" in source
    assert "#define PERIOD 10 " in source


def test_a_network_with_more_weights_than_cycles_is_refused() -> None:
    policy = random_policy(19, hidden_layers=(400, 400))
    made = engine_layout(policy, FLIGHT)
    (fault,) = crazyflie.faults(DeployablePolicy(policy, made), made)
    assert "has 170008 weights, and a call 168000 cycles. Train with smaller hidden_layers" in fault


def test_faults_of_a_policy_are_listed_at_once(tmp_path: Path) -> None:
    policy = random_policy(19)
    made = engine_layout(policy, FLIGHT, rate_hz=60.0)
    seen, command = made.observation, ("thrust - 1 [weights]", "roll [rad]", "pitch [rad]", "yaw rate [rad/s]")
    terms = (replace(seen[0], term="last_action"), replace(seen[1], history=3), *seen[2:])
    made = replace(made, observation=terms, command=command, rotors=made.rotors[:3])
    with pytest.raises(ConfigError) as error:
        write_policy(policy, made, tmp_path, ["c99", "crazyflie"])
    faults = error.value.args
    assert [fault.partition(":")[0] for fault in faults] == ["crazyflie"] * 5
    for fault, words in zip(
        faults, ("observes last_action", "3 steps of", "rotor_speed_control or no_control", "quadrotor in X", "60 Hz"),
        strict=True,
    ):  # fmt: skip
        assert words in fault
        assert "rain " in fault or "xport " in fault, "names no alternative"
    assert not list(tmp_path.iterdir()), "files were written all the same"
