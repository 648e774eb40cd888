"""Interface of a control law to the fused kernel.

Letters: E environments, R rotors.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import warp as wp
from torch import Tensor

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.law_memory import LawNeeds
from aerial_gym.physics.vehicle import Vehicle


@wp.struct
class NoGains:
    """Stand-in for the gains of a law without gains."""

    unused: float


def gain_rows(struct: Any, gains: Any) -> dict[str, Tensor]:
    """Return ``FusedLaw.gains`` for a struct from an object with the same attributes, (E, ...), floats as (E, 1)."""
    rows: dict[str, Tensor] = {}
    for name, kind in struct.cls.__annotations__.items():
        value = getattr(gains, name)
        if hasattr(kind, "cls"):
            rows |= {f"{name}.{inner}": row for inner, row in gain_rows(kind, value).items()}
        else:
            rows[name] = value[:, 0] if kind is float else value
    return rows


@dataclass(frozen=True, kw_only=True)
class FusedLaw:
    """A control law as Warp code with its parameters.

    The action is a rotor ``speed`` [rad/s] or a rotor ``thrust`` [N], clamped to ``low`` and ``high``, or it goes through
    ``wrench`` and the ``allocation`` to thrusts.
    """

    output: Literal["speed", "thrust", "wrench"]  # Kind of the law's output
    num_actions: int  # Number of entries of an action
    low: Tensor  # Lower limit of speed or thrust, (E, R)
    high: Tensor  # Upper limit, (E, R)

    thrust_map: Tensor | None = None
    """Declared thrust polynomial, from thrust to commanded speed, (E, R, 3); not needed for a speed."""

    reverse_thrust_map: Tensor | None = None  # The same for reversed rotors; ``thrust_map`` by default
    allocation: Tensor | None = None  # Allocation from the wrench to thrusts, (E, R, 6); not needed for a speed

    follow: Callable[[Vehicle], Mapping[str, Tensor]] | None = None
    """Row function from the vehicle of each environment to those fields above that depend on it, (E, ...); None without any."""

    saturation: Literal["prioritised", "clamp"] = "clamp"
    """Rule for thrusts beyond the rotor limits (``control.allocation``)."""

    lateral: bool = True  # Whether the wrench has lateral force; without it, its computation is omitted
    idle: bool = True  # Whether any rotor has no part in the force along body z

    wrench: wp.Function | None = None
    """``wp.func`` (position, attitude, lin_vel, ang_vel, prepared action, gains) -> (force, torque), body,
    ``wp.spatial_vector``."""

    prepare: wp.Function | None = None
    """``wp.func`` (action, gains) -> vector for ``wrench``, computed once per launch; the action itself by default."""

    make_stateful_step: "Callable[[FusedLaw, int, bool], wp.Function] | None" = None
    """For a law with memory, in place of ``wrench``: from this, the number of rotors and whether they are of any kind to a
    ``wp.func`` (params, gains, position, attitude, lin_vel, ang_vel, action, ``memory.LawArrays``, env, dt) -> commanded
    speeds, vector of R."""

    needs: LawNeeds | None = None  # Memory that the law needs
    gains_type: Any = None  # ``wp.struct`` of the gains

    gains: Mapping[str, Tensor] = field(default_factory=dict)
    """A tensor (E, ...) for each field of ``gains_type``, in its order; ``a.b`` is the field b of the struct a in it."""

    @property
    def num_prepared(self) -> int:
        """Number of entries of a prepared action."""
        return self.num_actions if self.prepare is None else self.prepare.func.__annotations__["return"]._length_


def preparation(prepare: wp.Function | None, num_actions: int) -> wp.Function:
    """Return ``FusedLaw.prepare``, or the identity without one."""
    action_type = vector_type(num_actions)

    @wp.func
    def identity(action: action_type, gains: Any) -> action_type:
        return action

    return identity if prepare is None else prepare
