"""Renderers for comparison, each in its own process."""

import os
from dataclasses import dataclass

from aerial_gym.errors import ConfigError
from aerial_gym.registry import Registry


@dataclass(frozen=True, kw_only=True)
class RenderPeer:
    """Another renderer."""

    needs: tuple[str, ...]  # Modules that must be importable
    install: str  # Distribution for pip
    devices: tuple[str, ...]  # ``cpu``, ``cuda``


RENDER_PEERS: Registry[RenderPeer] = Registry("render peer")

for _needs, _install, _devices in (
    (("newton",), "newton", ("cpu", "cuda")),
    (("mujoco",), "mujoco", ("cpu",)),
    (("mujoco_warp", "mujoco"), "mujoco-warp mujoco", ("cpu", "cuda")),
):
    RENDER_PEERS.register(_needs[0], RenderPeer(needs=_needs, install=_install, devices=_devices))


def interpreters(entries: tuple[str, ...], default: str) -> dict[str, str]:
    """Return the interpreter of every peer; ``entries`` are ``NAME=PYTHON``, or ``PYTHON`` for all that are not named."""
    named: dict[str, str] = {}
    for entry in entries:
        name, equals, python = entry.rpartition("=")
        if not python:
            raise ConfigError(
                f"--peer-python {entry!r}: must be PYTHON or NAME=PYTHON, an interpreter that has the peer"
            )
        path = os.path.abspath(python) if os.sep in python else python
        if equals:
            RENDER_PEERS.get(name)
            named[name] = path
        else:
            default = path
    return {name: named.get(name, default) for name in RENDER_PEERS}
