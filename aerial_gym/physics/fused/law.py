"""What the fused kernel needs of a control law.

Letters: E environments, R rotors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import warp as wp
from torch import Tensor


@wp.struct
class NoGains:
    """Stands for the gains of a law that has none."""

    nothing: float


@dataclass(frozen=True, kw_only=True)
class FusedLaw:
    """A control law as Warp code with its parameters.

    The action is a rotor ``speed`` [rad/s] or a rotor ``thrust`` [N], clamped to ``low`` and ``high``, or it goes through
    ``wrench`` and the ``allocation`` to thrusts.
    """

    output: Literal["speed", "thrust", "wrench"]
    """What the law gives."""

    num_actions: int
    """Entries of an action."""

    low: Tensor
    """Lower limit of speed or thrust, (E, R)."""

    high: Tensor
    """Upper limit, (E, R)."""

    thrust_map: Tensor | None = None
    """Declared thrust polynomial, from thrust to commanded speed, (E, R, 3); not needed for a speed."""

    reverse_thrust_map: Tensor | None = None
    """Likewise of rotors that turn backwards; ``thrust_map`` if not given."""

    allocation: Tensor | None = None
    """From the wrench to thrusts, (E, R, 6); not needed for a speed."""

    saturation: Literal["prioritised", "clamp"] = "clamp"
    """What gives way where the thrusts of a wrench are beyond the limits (``control.allocation``)."""

    wrench: wp.Function | None = None
    """``wp.func`` (position, attitude, lin_vel, ang_vel, action, gains) -> (force, torque), body, ``wp.spatial_vector``."""

    gains_type: Any = None
    """``wp.struct`` of the gains."""

    load_gains: wp.Function | None = None
    """``wp.func`` (packed: wp.array2d[float], first: int, env: int) -> gains, from rows ``first``... of (N, E)."""

    gains: Mapping[str, Tensor] = field(default_factory=dict)
    """A tensor (E, ...) for each field of ``gains_type``, in its order."""
