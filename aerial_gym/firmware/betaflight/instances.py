"""Processes of the firmware, and the exchange of states and motor pulses with all of them in each step.

The loops over instances are system calls on their sockets. All requests are sent before the first reply is awaited, so that
the instances compute at the same time.
Letters: E environments.
"""

import os
import signal
import socket
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aerial_gym.errors import CapabilityError
from aerial_gym.firmware.betaflight.build import FirmwareBuild
from aerial_gym.firmware.betaflight.settings import EEPROM

STEP, KEEP, RESTORE = 0, 1, 2  # Kinds of request
REQUEST = np.dtype([("kind", "<u4"), ("repeats", "<u4"), ("state", "<f8", 18), ("channels", "<u2", 16)])
REPLY = np.dtype([("time_ns", "<u8"), ("pulses", "<f4", 16)])
REPLY_S = 10.0  # Longest wait for a reply [s]


class Instance:
    """One process of the firmware in a folder of its own."""

    def __init__(self, command: Sequence[str | Path], library: Path | None, folder: Path) -> None:
        """Start it; ``library`` is preloaded."""
        self.socket, end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.settimeout(REPLY_S)
        env = {**os.environ, "LOCKSTEP_SOCKET": str(end.fileno())}
        if library is not None:
            env["LD_PRELOAD"] = str(library)
        quiet = subprocess.DEVNULL
        with end:
            self.process = subprocess.Popen(
                command, cwd=folder, env=env, pass_fds=(end.fileno(),), stdin=quiet, stdout=quiet, stderr=quiet,
                process_group=0,
            )  # fmt: skip

    def close(self) -> str:
        """End it, and return how it ended."""
        self.socket.close()  # the firmware ends with its socket
        try:
            code = self.process.wait(1.0)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            return f"no reply within {REPLY_S:g} s"
        return f"ended by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


class InstanceGroup:
    """Instances of the firmware, one for each environment.

    An instance that ends leaves its environment without pulses; the others continue. ``ended`` has the reasons.
    """

    def __init__(self, command: Sequence[str | Path], library: Path | None, eeprom: bytes, num_envs: int) -> None:
        """Start the instances, each in a folder with its own copy of ``eeprom``."""
        self.requests, self.replies = np.zeros(num_envs, REQUEST), np.zeros(num_envs, REPLY)
        self.requests["repeats"] = 1
        self._request_rows, self._reply_rows = _rows(self.requests), _rows(self.replies)
        self._command, self._library, self._eeprom = command, library, eeprom
        self._folder = tempfile.TemporaryDirectory(prefix="aerial_gym_firmware_")
        self.ended: dict[int, str] = {}
        self.instances: dict[int, Instance] = {}
        self.start(range(num_envs))

    @classmethod
    def of_build(cls, build: FirmwareBuild, eeprom: bytes, num_envs: int) -> "InstanceGroup":
        """Return instances of a built firmware."""
        return cls([build.program], build.library, eeprom, num_envs)

    def start(self, envs: Sequence[int] | range) -> None:
        """Start instances for environments that have none."""
        for env in envs:
            folder = Path(self._folder.name) / str(env)
            folder.mkdir(exist_ok=True)
            (folder / EEPROM).write_bytes(self._eeprom)
            self.instances[env] = Instance(self._command, self._library, folder)
            self.ended.pop(env, None)

    def exchange(self, envs: Sequence[int] | None = None) -> NDArray[np.float32]:
        """Send ``requests`` of environments, all if not given, await the replies, and return the pulses [us], (E, 16).

        The rows of other environments, and of instances that have ended, keep their values.
        """
        asked = [env for env in (range(len(self.requests)) if envs is None else envs) if env in self.instances]
        sent = [env for env in asked if self._send(env)]
        for env in sent:
            self._receive(env)
        return self.replies["pulses"]

    def _send(self, env: int) -> bool:
        try:
            self.instances[env].socket.send(self._request_rows[env])
        except OSError:
            self._end(env)
        return env in self.instances

    def _receive(self, env: int) -> None:
        try:
            count = self.instances[env].socket.recv_into(self._reply_rows[env])
        except OSError:
            count = 0
        if count != REPLY.itemsize:
            self._end(env)

    def _end(self, env: int) -> None:
        self.ended[env] = self.instances.pop(env).close()
        self.replies["pulses"][env] = 0.0

    def repeat(self, kind: int, envs: Sequence[int], *, repeats: int = 1) -> None:
        """Exchange requests of another kind, or of many steps with the same state, and return to single steps."""
        self.requests["kind"], self.requests["repeats"] = kind, repeats
        self.exchange(envs)
        self.requests["kind"], self.requests["repeats"] = STEP, 1

    def require(self, envs: Sequence[int]) -> None:
        """Raise ``CapabilityError`` if the instance of one of these environments has ended."""
        for env in envs:
            if env in self.ended:
                raise CapabilityError(f"the firmware of environment {env} has ended: {self.ended[env]}")

    def close(self) -> None:
        """End all instances and remove their folders."""
        for env in tuple(self.instances):
            self.instances.pop(env).close()
        self._folder.cleanup()


def _rows(table: NDArray[np.void]) -> list[memoryview]:
    """Return the bytes of each row, which share the memory of the table."""
    content = table.view(np.uint8).reshape(len(table), -1)
    return [memoryview(row) for row in content]
