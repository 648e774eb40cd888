"""Connections to the instances of PX4, and the exchange of messages with all of them in each step.

PX4 opens a TCP connection to port 4560 plus its instance number. Its clock is the time of the last HIL_SENSOR. It answers each
one by HIL_ACTUATOR_CONTROLS once its control loops run; until then the simulation does not wait for it.
Letters: E environments.
"""

import socket
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from aerial_gym.errors import CapabilityError, ConfigError

PORT = 4560  # Of instance 0. Source: PX4, simulator_mavlink
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
REPLY_S = 10.0  # Longest wait for a reply [s]
BOOT_S = 0.001  # Wait in each step for an instance whose control loops do not run yet [s]
MOTORS = 16


class Px4Link:
    """One instance of PX4."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket, self._parser = connection, mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.controls = np.zeros(MOTORS, dtype=np.float32)  # Motor commands, 0 to 1; 0 if disarmed
        self.armed, self.runs, self.wants_states = False, False, False
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, messages: Iterable[mavlink.MAVLink_message]) -> None:
        """Send messages."""
        self.socket.settimeout(REPLY_S)
        self.socket.sendall(b"".join(message.pack(self._parser) for message in messages))

    def await_commands(self, time_us: int) -> None:
        """Wait for the motor commands of a time [us]; before the first ones, only look for them."""
        if self.runs:
            while not self.receive(REPLY_S, time_us):
                pass
            return
        with suppress(TimeoutError):
            self.receive(BOOT_S, time_us)

    def receive(self, seconds: float, time_us: int) -> bool:
        """Read what has arrived, waiting at most so long; return whether motor commands of a time, or later, are among it.

        Raises:
            ConnectionError: If PX4 has closed the connection.
            TimeoutError: If nothing arrives.
        """
        self.socket.settimeout(seconds)
        if not (content := self.socket.recv(65536)):
            raise ConnectionError("it closed the connection")
        answered = False
        for message in self._parser.parse_buffer(content) or ():
            if isinstance(message, mavlink.MAVLink_hil_actuator_controls_message):
                self.controls[:] = message.controls
                self.armed, self.runs = bool(message.mode & ARMED), True
                answered |= message.time_usec >= time_us
            elif (
                isinstance(message, mavlink.MAVLink_command_long_message)
                and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            ):
                self.wants_states |= message.param1 == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
        return answered


class Px4Links:
    """Instances of PX4, one for each environment. One that ends leaves its environment with stopped motors."""

    def __init__(self, num_envs: int, *, port: int = PORT) -> None:
        """Listen on loopback.

        Raises:
            ConfigError: If a port is no port.
            CapabilityError: If ports are taken; names all of them.
        """
        if not 0 < port <= 65536 - num_envs:
            raise ConfigError(f"port = {port}: must be 1 to {65536 - num_envs}, as each environment has the next one")
        self._listening, taken = list[socket.socket](), list[int]()
        self.links, self.ended = dict[int, Px4Link](), dict[int, str]()
        self.controls = np.zeros((num_envs, MOTORS), dtype=np.float32)
        for number in range(port, port + num_envs):
            listener = socket.socket()
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind(("127.0.0.1", number))
                listener.listen(1)
            except OSError:
                taken.append(number)
                listener.close()
            else:
                self._listening.append(listener)
        if taken:
            self.close()
            names = ", ".join(map(str, taken))
            raise CapabilityError(
                f"sitl px4: ports {names} are taken. Give another first port (--port), or end what uses them"
            )
        self.port = port

    def accept(self, seconds: float) -> None:
        """Wait for a connection of each instance.

        Raises:
            CapabilityError: If some do not connect within ``seconds``; names their ports.
        """
        end = time.monotonic() + seconds
        for env, listener in enumerate(self._listening):
            listener.settimeout(max(0.01, end - time.monotonic()))
            try:
                self.links[env] = Px4Link(listener.accept()[0])
            except TimeoutError:
                continue
        if missing := [str(self.port + env) for env in range(len(self._listening)) if env not in self.links]:
            raise CapabilityError(
                f"sitl px4: nothing connected to port {', '.join(missing)} within {seconds:g} s. Start one PX4 for each "
                "environment (make px4_sitl none_iris; -i NUMBER)"
            )

    def exchange(self, time_us: int, *messages: Sequence[mavlink.MAVLink_message]) -> NDArray[np.float32]:
        """Send messages to all instances, await their motor commands, and return these, 0 to 1, (E, 16).

        An instance whose control loops do not run yet is not awaited.

        Args:
            time_us: Time of the simulation [us], which PX4 takes for its own and returns with the motor commands.
            messages: For each kind, one for each environment; HIL_SENSOR last, as it moves PX4's clock.
        """
        for env in tuple(self.links):
            self._guard(env, lambda link, env=env: link.send(kind[env] for kind in messages))
        for env in tuple(self.links):
            self._guard(env, lambda link: link.await_commands(time_us))
        return self.controls

    def _guard(self, env: int, work: Callable[[Px4Link], None]) -> None:
        try:
            work(self.links[env])
            self.controls[env] = self.links[env].controls
        except TimeoutError:
            self._end(env, f"no motor commands within {REPLY_S:g} s")
        except OSError as error:
            self._end(env, str(error))

    def _end(self, env: int, reason: str) -> None:
        self.links.pop(env).socket.close()
        self.ended[env] = reason
        self.controls[env] = 0.0

    def close(self) -> None:
        """Close all connections."""
        for env in tuple(self.links):
            self.links.pop(env).socket.close()
        for listener in self._listening:
            listener.close()
