"""Controllers of the Crazyflie's firmware in the loop. These tests take gcc and a checkout of the firmware."""

import os
import shutil
from pathlib import Path

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.firmware.crazyflie.build import VARIABLE, build_controller
from aerial_gym.firmware.crazyflie.comparison import compare_controller
from aerial_gym.firmware.crazyflie.environment import make_hover_env
from aerial_gym.firmware.crazyflie.instances import ControllerGroup
from aerial_gym.firmware.flight import fly_hover
from aerial_gym.task import task_registry

CHECKOUT = Path(os.environ.get(VARIABLE) or Path(__file__).parents[3] / "shared" / "outside" / "crazyflie_firmware")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is missing"),
    pytest.mark.skipif(not CHECKOUT.is_dir(), reason=f"no checkout of crazyflie-firmware: set {VARIABLE}"),
]


@pytest.mark.parametrize("name", ["pid", "mellinger", "lee"])
def test_it_hovers_within_10_cm_and_repeats_bit_for_bit(name: str) -> None:
    env = make_hover_env("crazyflie_21", name, checkout=CHECKOUT, instances=4)
    first = fly_hover(env, duration=10.0)
    assert first.hover_error_max_m is not None
    assert first.hover_error_max_m < 0.1
    env.restart(0)
    assert fly_hover(env, duration=10.0).trajectory_sha256 == first.trajectory_sha256
    alone = make_hover_env("crazyflie_21", name, checkout=CHECKOUT, instances=1)
    fly_hover(alone, duration=10.0)
    torch.testing.assert_close(alone.gtd["robot_position"], env.gtd["robot_position"][:1], atol=0.0, rtol=0.0)
    alone.close()
    env.close()


@pytest.mark.parametrize("name", ["pid", "mellinger", "lee"])
def test_the_controller_here_does_what_the_firmware_does(name: str) -> None:
    """Commands differ by two counts of 65,535 at most, which are whole in the firmware. From rest they are the square root of
    that share of the largest speed, at hover less than the share itself."""
    share, difference = 2.0 / 65535.0, compare_controller(name, checkout=CHECKOUT, duration=4.0)
    assert difference.rms < share
    assert difference.largest < share**0.5


def test_indi_of_the_checkout_hovers() -> None:
    if not (CHECKOUT / "src/modules/src/controller/controller_indi.c").is_file():
        pytest.skip("the checkout has no INDI controller")
    env = make_hover_env("crazyflie_21", "indi", checkout=CHECKOUT, instances=2)
    flight = fly_hover(env, duration=10.0)
    env.close()
    assert flight.hover_error_max_m is not None
    assert flight.hover_error_max_m < 0.1


def test_a_task_is_flown_by_the_firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(CHECKOUT))
    options = {"robot": "crazyflie_21", "controller": "crazyflie_mellinger_control", "firmware": "crazyflie"}
    with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", **options) as task:
        task.reset()
        for _ in range(5):
            _, reward, *_ = task.step(torch.zeros(2, 4))
        assert bool(reward.isfinite().all())


def test_an_unknown_parameter_is_refused_by_its_name(tmp_path: Path) -> None:
    library = build_controller("pid", CHECKOUT, tmp_path, {})
    with pytest.raises(ConfigError, match=r"no parameter posCtlPid\.wKp"):
        ControllerGroup(library, {"posCtlPid.wKp": 1.0, "posCtlPid.xKp": 2.0}, 1)
