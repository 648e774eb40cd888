"""A small stand-in for the firmware: answers the exchange like the preload library, and flies by proportional rate control.

It needs nothing but Python. The first auxiliary channel arms it. Kept moments are copies of the process, as there.
Yaw stick at its lowest end makes it crash.
"""

import os
import signal
import socket
import struct
import sys

REQUEST, REPLY = struct.Struct("<II18d16H"), struct.Struct("<Q16f")
STEP, KEEP, RESTORE = 0, 1, 2
RESTORED = 42


def fork_copies() -> None:
    while True:
        copy = os.fork()
        if copy == 0:
            return
        status = os.waitpid(copy, 0)[1]
        if not os.WIFEXITED(status) or os.WEXITSTATUS(status) != RESTORED:
            os.kill(os.getpid(), signal.SIGKILL) if os.WIFSIGNALED(status) else os._exit(os.WEXITSTATUS(status))


def pulses(rates: tuple[float, ...], channels: tuple[int, ...]) -> list[float]:
    """Return the pulses of the motors rear right, front right, rear left, front left."""
    if channels[4] < 1700:
        return [1000.0] * 4
    roll, pitch, yaw = (
        0.05 * ((channel - 1500) / 500 * 11.7 - sign * rate)
        for channel, rate, sign in zip((channels[0], channels[1], 3000 - channels[3]), rates, (1, -1, -1), strict=True)
    )
    throttle = (channels[2] - 1000) / 1000
    mixed = (throttle - roll + pitch + yaw, throttle - roll - pitch - yaw)
    mixed += (throttle + roll + pitch - yaw, throttle + roll - pitch + yaw)
    return [1000.0 + 1000.0 * min(max(signal, 0.001), 1.0) for signal in mixed]


def main() -> None:
    link = socket.socket(fileno=int(os.environ["LOCKSTEP_SOCKET"]))
    time, motors = 0, [1000.0] * 4
    while content := link.recv(REQUEST.size):
        kind, repeats, *numbers = REQUEST.unpack(content)
        state, channels = numbers[:18], numbers[18:]
        if kind == RESTORE:
            os._exit(RESTORED)
        if kind == KEEP:
            fork_copies()
        else:
            time += repeats
            motors = pulses(tuple(state[1:4]), tuple(channels))
            if channels[3] == 2000:
                os.kill(os.getpid(), signal.SIGSEGV)
        link.send(REPLY.pack(time, *motors, *[0.0] * 12))


if __name__ == "__main__":
    main()
    sys.exit(0)
