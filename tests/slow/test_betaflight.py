"""Betaflight itself in the loop: it arms, hovers and races in lockstep. These tests take gcc, make and the network."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.firmware.betaflight.build import build_firmware
from aerial_gym.firmware.betaflight.comparison import SETTINGS, compare_settings
from aerial_gym.firmware.betaflight.environment import BetaflightEnv, make_hover_env
from aerial_gym.firmware.betaflight.instances import InstanceGroup
from aerial_gym.firmware.betaflight.settings import store_settings
from aerial_gym.firmware.flight import fly_hover
from tests.unit.firmware.test_instances import exists

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None or shutil.which("make") is None, reason="gcc or make is missing"),
]


@pytest.fixture
def env() -> Iterator[BetaflightEnv]:
    made = make_hover_env("racing_quadrotor", instances=4, exchange_hz=1000.0)
    yield made
    made.close()


def test_it_hovers_within_10_cm_and_repeats_bit_for_bit(env: BetaflightEnv) -> None:
    first = fly_hover(env, duration=10.0)
    assert first.hover_error_max_m is not None
    assert first.hover_error_max_m < 0.1
    env.restart(0)
    assert fly_hover(env, duration=10.0).trajectory_sha256 == first.trajectory_sha256
    alone = make_hover_env("racing_quadrotor", instances=1, exchange_hz=1000.0)
    fly_hover(alone, duration=10.0)
    torch.testing.assert_close(alone.gtd["robot_position"], env.gtd["robot_position"][:1], atol=0.0, rtol=0.0)
    alone.close()


@pytest.mark.parametrize("exchange_hz", [2000.0, 4000.0])
def test_it_flies_at_higher_rates(exchange_hz: float) -> None:
    env = make_hover_env("racing_quadrotor", instances=1, exchange_hz=exchange_hz)
    before = int(env.group.replies["time_ns"][0])
    flight = fly_hover(env, duration=10.0)
    env.close()
    assert flight.hover_error_max_m is not None
    assert flight.hover_error_max_m < 0.1
    assert (int(env.group.replies["time_ns"][0]) - before) / 1e9 == pytest.approx(10.0, abs=2e-4)


def test_a_crash_of_one_instance_ends_its_environment_alone(env: BetaflightEnv) -> None:
    os.killpg(env.group.instances[2].process.pid, signal.SIGSEGV)
    flight = fly_hover(env, duration=10.0)
    assert flight.ended == {}  # the first reset has started it again
    os.killpg(env.group.instances[2].process.pid, signal.SIGSEGV)
    env.step(torch.zeros(4, 4))
    assert env.group.ended == {2: "ended by SIGSEGV"}
    assert env.gtd["crashes"].tolist() == [False, False, True, False]


def test_it_opens_no_port(env: BetaflightEnv) -> None:
    env.reset()
    for instance in env.group.instances.values():
        for process in Path("/proc").glob("[0-9]*"):
            if process.joinpath("stat").read_text().rpartition(")")[2].split()[2] == str(instance.process.pid):
                opened = [os.readlink(each) for each in (process / "fd").iterdir()]
                assert sum(each.startswith("socket:") for each in opened) == 1


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_no_process_remains_after_the_command_is_killed(end: signal.Signals) -> None:
    script = (
        "import signal, torch; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from aerial_gym.firmware.betaflight.environment import make_hover_env;"
        "env = make_hover_env('racing_quadrotor', instances=2, exchange_hz=1000.0); env.reset();"
        "print(*(each.process.pid for each in env.group.instances.values()), flush=True)\n"
        "while True: env.step(torch.zeros(2, 4))"
    )
    program = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert program.stdout is not None
    groups = [int(pid) for pid in program.stdout.readline().split()]
    program.send_signal(end)
    program.wait(60.0)
    limit = time.monotonic() + 10.0
    while time.monotonic() < limit and any(exists(group) for group in groups):
        time.sleep(0.05)
    assert len(groups) == 2
    assert not any(exists(group) for group in groups)


def test_the_controller_here_does_what_the_firmware_does() -> None:
    """Within a throttle step of 1 us, which the firmware cuts to whole microseconds twice. TPA acts one run later there."""
    rows = {row.setting: row for row in compare_settings(duration=1.0, instances=2)}
    assert rows.keys() == SETTINGS.keys()
    for name, row in rows.items():
        if "TPA" not in name:
            assert row.largest < 1.01e-3, row
    assert rows["TPA of P and D, 65 % from 1350"].rms < 5e-3


def test_an_unknown_setting_is_refused_by_its_name() -> None:
    with pytest.raises(ConfigError, match="INVALID NAME: no_such_setting"):
        store_settings(build_firmware(), ["set no_such_setting=1"])


def test_the_hang_of_an_instance_ends_it(env: BetaflightEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    env.reset()
    instance = env.group.instances[1]
    instance.socket.settimeout(0.5)
    os.killpg(instance.process.pid, signal.SIGSTOP)
    env.step(torch.zeros(4, 4))
    assert env.group.ended.keys() == {1}
    assert not exists(instance.process.pid)
    assert isinstance(env.group, InstanceGroup)
