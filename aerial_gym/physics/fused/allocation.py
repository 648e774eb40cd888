"""Allocation of a wrench to thrusts with rotor limits: the Warp version of ``control.allocation.allot``.

Letters: R rotors.
"""

import warp as wp

from aerial_gym.physics.fused.types import rotor_types

NEGLIGIBLE = wp.constant(1.0e-6)
"""Relative size of round-off: of differences to their sum, and of entries of the pseudo-inverse times the largest entry of the
matrix for that force or torque, which is near 1 for a rotor with a part in it."""

UNLIMITED = wp.constant(1.0e9)
"""Thrust limit along body z [N] of a rotor without part in it; finite, for finite gradients."""


def make_allot_thrust(
    num_rotors: int, general: bool = False, *, idle: bool, lateral: bool, differentiable: bool = False
) -> wp.Function:
    """Return the Warp version of ``control.allocation.allot``, from parameters and wrench to thrusts [N] and two shares.

    In the usual case without saturation it is the product with the pseudo-inverse and 2 R comparisons.

    Args:
        general: Whether to support every kind of rotor.
        idle: Whether any rotor has no part in the force along body z.
        lateral: Whether wrenches have lateral force.
        differentiable: Whether the adjoint is needed.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    turn_of, rest_of = _make_parts(lateral)
    spread = _make_spread(num_rotors, general, idle=idle, lateral=lateral, differentiable=differentiable)

    @wp.func
    def allot_thrust(params: command_type, wanted: wp.spatial_vector):
        thrust = vector()
        for i in range(wp.static(num_rotors)):
            row = params.allocation[i]
            thrust[i] = row[2] * wanted[2] + turn_of(row, wanted) + rest_of(row, wanted)
        turn = wp.float32(1.0)
        rest = wp.float32(1.0)
        inside = bool(True)  # noqa: UP018
        for i in range(wp.static(num_rotors)):
            if not (thrust[i] >= params.low[i] and thrust[i] <= params.high[i]):
                inside = False
        if not inside:
            thrust, turn, rest = spread(params, wanted)
        return thrust, turn, rest

    return allot_thrust


def _make_spread(num_rotors: int, general: bool, *, idle: bool, lateral: bool, differentiable: bool) -> wp.Function:
    """Return the rare path with a saturated rotor, which treats pairs of rotors as in torch.

    Unrolled, it would need more GPU registers than the rest of a kernel. A loop step that the compiler does not know keeps its
    loops. An adjoint needs the values of every iteration, which Warp keeps for unrolled loops only; there the step is known.
    """
    types = rotor_types(num_rotors, general)
    command_type, vector = types.command, types.vector
    turn_of, rest_of = _make_parts(lateral)
    table_type = wp.types.matrix(shape=(num_rotors, 4), dtype=wp.float32)

    @wp.func
    def spread(params: command_type, wanted: wp.spatial_vector):
        one = 1
        if wp.static(not differentiable):
            one = 1 + int(0.0 * params.high[0])
        table = table_type()
        thrust = vector()
        for i in range(0, wp.static(num_rotors), one):
            row = params.allocation[i]
            if row[2] == 0.0:
                table[i] = wp.vec4(-UNLIMITED, UNLIMITED, 0.0, 0.0)
                thrust[i] = wp.clamp(0.0, params.low[i], params.high[i])
            else:
                low = params.low[i] / row[2]
                high = params.high[i] / row[2]
                table[i] = wp.vec4(
                    wp.min(low, high), wp.max(low, high), turn_of(row, wanted) / row[2], rest_of(row, wanted) / row[2]
                )
        shares = wp.vec2()
        for stage in range(0, 2, one):  # roll and pitch, then yaw and lateral force
            share = wp.float32(1.0)
            for i in range(0, wp.static(num_rotors), one):
                if wp.static(idle):
                    row = params.allocation[i]
                    change = wp.where(stage == 0, turn_of(row, wanted), rest_of(row, wanted))
                    if row[2] == 0.0:
                        share = limit_share(
                            share, thrust_margin(params.low[i], params.high[i], thrust[i], change), change
                        )
                for j in range(0, wp.static(num_rotors), one):
                    upper = table[j, SLOPE + stage]
                    lower = table[i, SLOPE + stage]
                    need = upper - lower
                    if need > NEGLIGIBLE * (wp.abs(upper) + wp.abs(lower)):  # else equal rotors
                        share = limit_share(share, table[j, CEILING] - table[i, FLOOR], need)
            shares[stage] = share
            if stage == 0:
                for i in range(0, wp.static(num_rotors), one):
                    table[i, FLOOR] -= share * table[i, SLOPE]
                    table[i, CEILING] -= share * table[i, SLOPE]
                    if wp.static(idle):
                        row = params.allocation[i]
                        if row[2] == 0.0:
                            thrust[i] += share * turn_of(row, wanted)
        collective = float(wanted[2])
        for side in range(0, 2, one):  # from below to the ceiling, then from above to the floor
            sign = 1.0 - 2.0 * float(side)
            edge = sign * collective
            for i in range(0, wp.static(num_rotors), one):
                own = sign * table[i, CEILING - side]
                up = sign * table[i, TWIST]
                edge = wp.min(edge, own - shares[1] * wp.min(up, 0.0))
                for j in range(0, wp.static(num_rotors), one):
                    down = sign * table[j, TWIST]
                    if up > 0.0 and down < 0.0:
                        edge = wp.min(edge, own + up / (up - down) * (sign * table[j, CEILING - side] - own))
            collective = sign * edge
        rest_share = wp.float32(1.0)
        for i in range(0, wp.static(num_rotors), one):
            row = params.allocation[i]
            if row[2] != 0.0:
                thrust[i] = shares[0] * turn_of(row, wanted) + collective * row[2]
            rest = rest_of(row, wanted)
            rest_share = limit_share(rest_share, thrust_margin(params.low[i], params.high[i], thrust[i], rest), rest)
        allowed = vector()
        for i in range(0, wp.static(num_rotors), one):
            given = thrust[i] + rest_share * rest_of(params.allocation[i], wanted)
            allowed[i] = wp.clamp(given, params.low[i], params.high[i])
        return allowed, shares[0], rest_share

    return spread


FLOOR, CEILING, SLOPE, TWIST = (wp.constant(column) for column in range(4))
"""Columns of the table of lifting rotors: limits of the force along body z, and the shares of roll and pitch, and of yaw and
lateral force, in it."""


def _make_parts(lateral: bool) -> tuple[wp.Function, wp.Function]:
    """Return the functions of a rotor's thrust for roll and pitch torque, and for yaw torque and lateral force."""

    @wp.func
    def tilt_thrust(row: wp.spatial_vector, wanted: wp.spatial_vector) -> float:
        return row[3] * wanted[3] + row[4] * wanted[4]

    @wp.func
    def yaw_thrust(row: wp.spatial_vector, wanted: wp.spatial_vector) -> float:
        rest = row[5] * wanted[5]
        if wp.static(lateral):
            rest += row[0] * wanted[0] + row[1] * wanted[1]
        return rest

    return tilt_thrust, yaw_thrust


@wp.func
def limit_share(share: float, room: float, change: float) -> float:
    """Return the smaller of a share and ``room / change``."""
    if share * wp.abs(change) > wp.max(room, 0.0):
        share = wp.max(room, 0.0) / wp.abs(change)
    return share


@wp.func
def thrust_margin(low: float, high: float, thrust: float, change: float) -> float:
    """Return the margin of a thrust to its limit in the direction of a change [N]."""
    return wp.where(change > 0.0, high - thrust, thrust - low)
