"""The peers, the cases, and our command in each case."""

import os
from dataclasses import dataclass

from aerial_gym.errors import ConfigError
from aerial_gym.registry import Registry

CASES: dict[str, tuple[str, ...]] = {
    "plant": ("--integrator", "euler", "--controller", "rotor_speed_control"),
    "rk4": ("--integrator", "rk4", "--controller", "rotor_speed_control"),
    "attitude": ("--integrator", "euler", "--controller", "lee_attitude_control"),
}
"""Our options by case; rotor lag and linear drag are in all of them."""


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another simulator."""

    needs: str  # Module that must be importable
    script: str  # Module of ours that runs it
    cases: tuple[str, ...]  # What it can do of `CASES`
    devices: tuple[str, ...]  # `cpu`, `cuda`


PEERS: Registry[Peer] = Registry("peer")

for _name, _needs, _cases, _devices in (
    ("crazyflow", "crazyflow.sim", ("plant", "rk4", "attitude"), ("cpu", "cuda")),
    ("l2f", "l2f", ("rk4",), ("cpu",)),
    ("hyperdrone", "hyperdrone.dynamics", ("rk4",), ("cpu", "cuda")),
    ("rotorpy", "rotorpy.vehicles.multirotor", ("rk4",), ("cpu", "cuda")),
    ("mujoco", "mujoco.rollout", ("plant", "rk4"), ("cpu",)),
):
    PEERS.register(_name, Peer(needs=_needs, script=f"benchmarks.peers.peer_{_name}", cases=_cases, devices=_devices))


def interpreters(entries: tuple[str, ...], default: str) -> dict[str, str]:
    """Return the interpreter of every peer; ``entries`` are ``NAME=PYTHON``, the others get ``default``."""
    result = dict.fromkeys(PEERS, default)
    for entry in entries:
        name, equals, python = entry.partition("=")
        if not equals or not python:
            raise ConfigError(f"--peer {entry!r}: must be NAME=PYTHON, the interpreter that has the peer")
        PEERS.get(name)
        result[name] = os.path.abspath(python) if os.sep in python else python
    return result
