"""What a simulation needs of a physics backend, and the backend that can do it.

A need that a backend cannot meet is refused by its name, with the registered backends that can.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.backend import Capabilities, PhysicsBackend
from aerial_gym.physics.catalog import BACKENDS
from aerial_gym.physics.effects import LearnedResidual

BACKEND_PREFERENCE = ("warp", "torch")  # Backends that `auto` tries, in order


@dataclass(frozen=True, kw_only=True)
class Needs:
    """Needed capabilities of a backend."""

    device: torch.device  # Device of the simulation
    dtype: torch.dtype = torch.float32  # Float type of the state
    integrator: str | None = None  # Name of an integrator; None for any
    effects: tuple[str, ...] = ()  # Names of effects
    rotors: frozenset[str] = frozenset()  # Traits of rotors, of `config.rotor.ROTOR_TRAITS`
    contact: bool = False  # Whether ground or obstacles have contact forces
    gradients: bool = False  # Whether gradients flow through a step
    joints: bool = False  # Whether the vehicle has joints
    contact_of_links: bool = False  # Whether links have contact forces with ground, obstacles or each other


def robot_needs(robot: RobotCfg, device: torch.device, **fields: object) -> Needs:
    """Return the needs of a robot, with further fields of ``Needs`` by name."""
    learned = () if robot.learned_residual is None else (LearnedResidual.name,)
    fields.setdefault("joints", robot.joints is not None)
    return Needs(device=device, effects=(*robot.effects, *learned), rotors=robot.rotor_traits, **fields)  # type: ignore[arg-type]


def _unmet_needs(able: Capabilities, needs: Needs) -> Iterator[str]:
    """Yield the unmet needs, as words that follow 'cannot'."""
    if needs.device.type not in able.devices:
        yield f"run on {needs.device} (devices: {', '.join(able.devices)})"
    if needs.dtype not in able.dtypes:
        yield f"compute in {needs.dtype} (float types: {', '.join(map(str, able.dtypes))})"
    if needs.integrator is not None and needs.integrator not in able.integrators:
        yield f"run integrator {needs.integrator!r} (integrators: {', '.join(able.integrators)})"
    for name in needs.effects:
        if name in able.lacks or (able.effects is not None and name not in able.effects):
            yield f"run effect {name!r}"
    for trait in sorted(needs.rotors - set(able.rotors)):
        yield f"run {_ROTOR_WORDS[trait]}"
    for name, words in (
        ("contact", "push back at a contact"),
        ("joints", "move joints"),
        ("contact_of_links", "push back at a contact of a vehicle with joints"),
    ):
        if getattr(needs, name) and not getattr(able, name):
            yield words
    if needs.gradients and not able.differentiable:
        yield "pass gradients through a step"


_ROTOR_WORDS = {
    "reversible": "reversible rotors",
    "force": "rotors in force mode",
    "slew": "rotors with a slew rate",
    "dead_band": "rotors with a dead band",
}


def choose_backend(name: str, *, needs: Needs | None = None) -> PhysicsBackend:
    """Return a new backend by name.

    ``auto`` takes the first registered one of ``BACKEND_PREFERENCE`` that supports the needed gradients, float type and
    joints.

    Raises:
        CapabilityError: If it does not meet a need.
    """
    if name == "auto":
        present = [candidate for candidate in BACKEND_PREFERENCE if candidate in BACKENDS]
        special = needs is not None and (needs.gradients or needs.joints or needs.dtype != torch.float32)
        able = [n for n in present if not special or needs is None or _has_type(BACKENDS.get(n)().capabilities, needs)]
        name = (able or present)[0]
    backend = BACKENDS.get(name)()
    if needs is not None:
        require(backend, needs, name=name)
    return backend


def _has_type(able: Capabilities, needs: Needs) -> bool:
    able_to_bend = able.joints or not needs.joints
    return needs.dtype in able.dtypes and (able.differentiable or not needs.gradients) and able_to_bend


def require(backend: PhysicsBackend, needs: Needs, *, name: str | None = None) -> None:
    """Raise ``CapabilityError`` for an unmet need, with the backends that meet it."""
    lacking = list(_unmet_needs(backend.capabilities, needs))
    if not lacking:
        return
    known = dict.fromkeys((*BACKEND_PREFERENCE, *sorted(BACKENDS)))
    alternatives = [
        n for n in known if n != name and n in BACKENDS and not any(_unmet_needs(BACKENDS.get(n)().capabilities, needs))
    ]
    way_out = (
        f"Use backend {', '.join(map(repr, alternatives))}."
        if alternatives
        else "No registered backend can: leave it out."
    )
    raise CapabilityError(f"backend {name or type(backend).__name__}: cannot {lacking[0]}. {way_out}")
