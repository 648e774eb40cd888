"""The exchange with instances of a firmware, with a small stand-in: resets, ends of instances, and ends of this program."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from aerial_gym.firmware.betaflight.environment import BetaflightEnv
from aerial_gym.firmware.betaflight.instances import InstanceGroup
from aerial_gym.firmware.flight import fly_hover
from aerial_gym.robots import ROBOTS
from tests.builders import simulation

FAKE = Path(__file__).with_name("fake_firmware.py")


def make_group(eeprom: bytes, num_envs: int) -> InstanceGroup:
    return InstanceGroup([sys.executable, FAKE], None, eeprom, num_envs)


def build(num_envs: int = 3, robot: str = "racing_quadrotor", law: str = "betaflight_rate_control") -> BetaflightEnv:
    return BetaflightEnv(
        controller=CONTROLLERS.get(law), sim=SIMS.get("base_sim"), env=ENVIRONMENTS.get("empty_env"),
        robot=ROBOTS.get(robot), num_envs=num_envs, device=torch.device("cpu"), seed=0, make_group=make_group,
    )  # fmt: skip


@pytest.fixture
def env() -> Iterator[BetaflightEnv]:
    made = build()
    yield made
    made.close()


def test_a_flight_repeats_bit_for_bit_after_a_reset(env: BetaflightEnv) -> None:
    flights = []
    for _ in range(2):
        env.restart(0)
        flights.append(fly_hover(env, duration=0.5).trajectory_sha256)
    assert flights[0] == flights[1]
    env.restart(1)
    assert fly_hover(env, duration=0.5).trajectory_sha256 != flights[0]


def test_the_stand_in_turns_the_vehicle_as_the_action_says(env: BetaflightEnv) -> None:
    """Signs of sticks, gyro and motors: each axis reaches a rate of the commanded sign."""
    env.reset()
    env.gtd["robot_body_angvel"].zero_()
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    wanted = torch.tensor([[0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 2.0]])
    for _ in range(30):
        env.step(wanted)
    reached = env.gtd["robot_body_angvel"]
    assert (reached.diagonal() > 0.5).all(), reached
    assert (reached - torch.diag(reached.diagonal())).abs().max() < 0.1
    torch.testing.assert_close(env.gtd["robot_actions"], wanted, atol=0.0, rtol=0.0)


def test_the_end_of_one_instance_is_a_crash_of_its_environment_alone(env: BetaflightEnv) -> None:
    actions = torch.zeros(3, 4)
    env.reset()
    env.step(actions)
    actions[1, 3] = -100.0  # crashes the stand-in
    env.step(actions)
    assert env.gtd["crashes"].tolist() == [False, True, False]
    assert env.group.ended == {1: "ended by SIGKILL"}
    env.step(torch.zeros(3, 4))
    assert (env.gtd["rotor_speed"][(0, 2), :] > env.gtd["rotor_speed"][1]).all()
    env.reset(env.gtd["crashes"].clone())
    env.step(torch.zeros(3, 4))
    assert env.group.ended == {}
    assert env.gtd["crashes"].tolist() == [False, False, False]
    assert (env.group.replies["pulses"][:, :4] > 1000.0).all()


def test_a_reset_restores_the_instances_of_its_mask_only(env: BetaflightEnv) -> None:
    env.reset()
    for _ in range(3):
        env.step(torch.zeros(3, 4))
    times = env.group.replies["time_ns"].copy()
    env.reset(torch.tensor([False, True, False]))
    assert (env.group.replies["time_ns"] < times).tolist() == [False, True, False]


def test_what_does_not_fit_is_refused_with_a_remedy() -> None:
    with pytest.raises(ConfigError, match="takes body rates. Take betaflight_rate_control"):
        build(law="lee_attitude_control")
    with pytest.raises(ConfigError, match="four rotors in an X"):
        build(robot="typhoon_hexarotor")
    options = {"robot": "racing_quadrotor", "controller": "betaflight_rate_control"}
    with pytest.raises(UnknownNameError, match="no firmware 'betaflite'. Did you mean 'betaflight'"):
        simulation(**options, firmware="betaflite")
    env = build(1)
    with pytest.raises(CapabilityError, match="the memory of Betaflight cannot be saved"):
        env.save_state()
    env.close()


def test_no_process_remains_after_the_program_is_killed(tmp_path: Path) -> None:
    script = (
        "import signal, time; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from aerial_gym.firmware.betaflight.instances import KEEP, InstanceGroup;"
        f"group = InstanceGroup({[sys.executable, str(FAKE)]}, None, b'', 2); group.repeat(KEEP, (0, 1));"
        "print(*(each.process.pid for each in group.instances.values()), flush=True); time.sleep(60)"
    )
    for end in (signal.SIGKILL, signal.SIGINT):
        program = subprocess.Popen(
            [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert program.stdout is not None
        groups = [int(pid) for pid in program.stdout.readline().split()]
        assert len(groups) == 2
        program.send_signal(end)
        program.wait(60.0)
        limit = time.monotonic() + 10.0
        while time.monotonic() < limit and any(exists(group) for group in groups):
            time.sleep(0.05)
        assert not any(exists(group) for group in groups)


def exists(group: int) -> bool:
    """Return whether a process group, an instance with its copies, has a process that is no zombie."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    states = [
        text.rpartition(")")[2].split()
        for path in Path("/proc").glob("[0-9]*/stat")
        if (text := path.read_text(encoding="utf-8", errors="replace"))
    ]
    return any(int(state[2]) == group and state[0] != "Z" for state in states)


def test_periods_of_the_firmware_divide_the_step() -> None:
    sim = replace(SIMS.get("base_sim"), dt=0.0105)
    with pytest.raises(ConfigError, match=r"step of 0.0105 s: must be a multiple of the firmware's period, 0.001 s"):
        BetaflightEnv(
            controller=CONTROLLERS.get("betaflight_rate_control"), sim=sim, env=ENVIRONMENTS.get("empty_env"),
            robot=ROBOTS.get("racing_quadrotor"), num_envs=1, device=torch.device("cpu"), seed=0, make_group=make_group,
        )  # fmt: skip
