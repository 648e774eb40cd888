import socket
import threading
from contextlib import suppress

import numpy as np
import pytest

pytest.importorskip("pymavlink")
from pymavlink.dialects.v20 import common as mavlink

from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.firmware.px4 import links
from aerial_gym.firmware.px4.links import Px4Links
from aerial_gym.firmware.px4.readings import Home, Readings
from tests.unit.firmware.px4.test_readings import motion


class FakePx4(threading.Thread):
    """Answers each HIL_SENSOR, after some of boot, by motor commands that count the sensor messages."""

    def __init__(self, port: int, *, boot: int = 3, ends_after: int = 10**9, commands=None) -> None:
        """``commands``: function of the last sensor message; None: their number / 1000."""
        super().__init__(daemon=True)
        self._port, self._boot, self._ends_after, self.seen = port, boot, ends_after, []
        self._commands = commands

    def run(self) -> None:
        with suppress(ConnectionError):  # the test ends before it
            self._answer()

    def _answer(self) -> None:
        codec = mavlink.MAVLink(None)
        with socket.create_connection(("127.0.0.1", self._port)) as connection:
            interval = (1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION)
            connection.sendall(mavlink.MAVLink_command_long_message(*interval, 5000, 0, 0, 0, 0, 0).pack(codec))
            count = 0
            while content := connection.recv(4096):
                for message in codec.parse_buffer(content) or ():
                    self.seen.append(message)
                    if message.get_type() != "HIL_SENSOR":
                        continue
                    count += 1
                    if count > self._ends_after:
                        return
                    if count > self._boot:
                        controls = [count / 1000.0] * 16 if self._commands is None else self._commands(message)
                        answer = mavlink.MAVLink_hil_actuator_controls_message(message.time_usec, controls, 129, 1)
                        connection.sendall(answer.pack(codec))


def free_port(count: int) -> int:
    """Return the first of some free ports in a row."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return min(probe.getsockname()[1], 65535 - count)


def connect(*peers_options: dict) -> tuple[Px4Links, list[FakePx4]]:
    group = Px4Links(len(peers_options), port=free_port(len(peers_options)))
    peers = [FakePx4(group.port + env, **options) for env, options in enumerate(peers_options)]
    for peer in peers:
        peer.start()
    group.accept(5.0)
    return group, peers


def advance(group: Px4Links, step: int) -> np.ndarray:
    """Send the sensors of a step, and return the motor commands."""
    return group.exchange(4000 * step, Readings(Home()).sensors(4000 * step, motion()) * len(group.controls)).copy()


def boot(group: Px4Links) -> int:
    """Advance until all instances give motor commands; return the number of steps."""
    step = 0
    while not all(link.runs for link in group.links.values()):
        advance(group, step := step + 1)
    return step


def test_each_step_gets_the_motor_commands_of_that_step():
    group, peers = connect({}, {"boot": 0})
    for step in range(boot(group) + 1, 200):
        assert advance(group, step)[:, 0] == pytest.approx([step / 1000.0] * 2, abs=1e-6)
    assert [len(peer.seen) for peer in peers] == [199, 199]
    assert all(link.armed for link in group.links.values())
    group.close()


def test_px4_asks_for_true_states():
    group, _ = connect({"boot": 0})
    boot(group)
    assert group.links[0].wants_states
    group.close()


def test_an_instance_that_ends_stops_only_its_own_motors():
    group, _ = connect({"boot": 0}, {"boot": 0, "ends_after": 5})
    for step in range(1, 40):
        controls = advance(group, step)
    assert group.ended.keys() == {1}
    assert np.all(controls[1] == 0.0)
    assert controls[0, 0] > 0.0
    group.close()


def test_silence_of_an_instance_ends_it(monkeypatch):
    group, peers = connect({"boot": 0})
    step = boot(group)
    peers[0]._boot = 10**9
    monkeypatch.setattr(links, "REPLY_S", 0.05)
    advance(group, step + 1)
    assert "no motor commands" in group.ended[0]
    group.close()


def test_all_taken_ports_are_named():
    with socket.socket() as first, socket.socket() as second:
        first.bind(("127.0.0.1", 0))
        first.listen()
        port = first.getsockname()[1]
        second.bind(("127.0.0.1", port + 2))
        second.listen()
        with pytest.raises(CapabilityError, match=f"{port}, {port + 2}"):
            Px4Links(3, port=port)


@pytest.mark.parametrize("port", [0, -1, 65534, 70000])
def test_a_number_that_is_no_port_is_refused(port: int):
    with pytest.raises(ConfigError, match="must be 1 to 65533"):
        Px4Links(3, port=port)


def test_instances_that_do_not_connect_are_named():
    port = free_port(2)
    group = Px4Links(2, port=port)
    FakePx4(port).start()
    with pytest.raises(CapabilityError, match=f"{port + 1} within"):
        group.accept(0.3)
    group.close()
