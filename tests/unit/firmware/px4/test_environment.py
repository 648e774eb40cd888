import pytest
import torch

pytest.importorskip("pymavlink")

from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.firmware.px4.environment import Px4Env
from aerial_gym.firmware.px4.flight import fly_px4, make_px4_env
from tests.unit.firmware.px4.test_links import FakePx4, free_port


def connect_peers(commands, *, instances: int = 1, robot: str = "x500_px4") -> tuple[Px4Env, list[FakePx4]]:
    """Return vehicles on the ground whose motors get ``commands``, a function of the last sensor message."""
    env = make_px4_env(robot, instances=instances, port=free_port(instances))
    peers = [FakePx4(env.links.port + number, boot=0, commands=commands) for number in range(instances)]
    for peer in peers:
        peer.start()
    env.connect(5.0)
    return env, peers


def test_vehicle_at_rest_feels_gravity_and_stays():
    env, peers = connect_peers(lambda _: [0.0] * 16)
    flight = fly_px4(env, duration=0.4)
    last = [message for message in peers[0].seen if message.get_type() == "HIL_SENSOR"][-1]
    assert last.zacc == pytest.approx(-9.81, abs=0.2)
    assert flight.highest_m[0] < 0.005
    env.close()


def test_more_than_hover_thrust_lifts_it_by_newton_s_law():
    env, _ = connect_peers(lambda _: [share] * 16)
    vehicle = env.robot_manager.declared
    hover = env.robot_manager.cfg.body.mass * 9.81 / 4.0
    low, high = float(vehicle.speed_low[0, 0]), float(vehicle.speed_high[0, 0])
    speed = (1.3 * hover / float(vehicle.thrust_map[0, 0, 2])) ** 0.5
    share = (speed - low) / (high - low)
    env.step()
    flight = fly_px4(env, duration=1.0)
    # 0.3 g for 1 s, less the time in which the rotors spin up
    assert 0.6 * 0.5 * 0.3 * 9.81 < flight.highest_m[0] < 0.5 * 0.3 * 9.81
    env.close()


@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_the_vehicle_as_its_parameters_say(motor: int):
    env, peers = connect_peers(lambda _: [0.9 if k == motor else 0.7 for k in range(16)])
    fly_px4(env, duration=0.3)
    last = [message for message in peers[0].seen if message.get_type() == "HIL_SENSOR"][-1]
    right, forward = (env.parameters[f"CA_ROTOR{motor}_P{axis}"] for axis in "YX")
    assert last.xgyro * right < 0.0  # more thrust to the right rolls to the left
    assert last.ygyro * forward > 0.0  # more thrust in front pitches up
    assert (
        last.zgyro * env.parameters[f"CA_ROTOR{motor}_KM"] > 0.0
    )  # a counter-clockwise rotor turns the body clockwise
    env.close()


def test_parameters_give_hover_thrust_and_outputs():
    env = make_px4_env("x500_px4", instances=1, port=free_port(1))
    own, cfg = env.parameters, env.robot_manager.cfg
    speed = (cfg.body.mass * 9.81 / 4.0 / float(env.robot_manager.declared.thrust_map[0, 0, 2])) ** 0.5
    signal = (speed - 150.0) / (1000.0 - 150.0)
    factor = own["THR_MDL_FAC"]
    assert own["MPC_THR_HOVER"] == pytest.approx(factor * signal**2 + (1.0 - factor) * signal, rel=0.01)
    assert [own[f"PWM_MAIN_FUNC{k}"] for k in range(1, 5)] == [101, 102, 103, 104]
    env.close()


def test_instances_are_independent_of_each_other():
    def commands(message):
        booted = message.time_usec > 1_300_000  # until then the simulation does not wait for them
        return [booted * (0.6 + 0.3 * (message.time_usec % 7 == 0))] * 16

    env, _ = connect_peers(commands, instances=3)
    fly_px4(env, duration=0.8)
    position = env.gtd["robot_position"]
    assert torch.equal(position[0], position[1])
    assert torch.equal(position[0], position[2])
    env.close()


def test_what_px4_cannot_do_is_refused():
    env, _ = connect_peers(lambda _: [0.0] * 16)
    env.step()
    with pytest.raises(CapabilityError, match="reset"):
        env.reset()
    with pytest.raises(CapabilityError, match="MAVSDK"):
        env.step(torch.zeros(1, 4))
    env.close()
    with pytest.raises(ConfigError, match="Take another robot"):
        make_px4_env("base_octarotor", instances=1, port=free_port(1))
