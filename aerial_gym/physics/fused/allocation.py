"""Thrusts of a wrench where rotors are at their limits: a hand-written Warp function with loops over pairs of rotors.

Letters: R rotors.
"""

import warp as wp

from aerial_gym.math.warp_functions import vector_type

NEGLIGIBLE = wp.constant(1.0e-6)
"""Relative size of round-off: of differences to their sum, and of entries of the pseudo-inverse times the largest entry of the
matrix for that force or torque, which is near 1 for a rotor with a part in it."""

UNLIMITED = wp.constant(1.0e9)  # Thrust limit along body z [N] of a rotor without part in it, for finite gradients


def make_thrusts_by_priority(num_rotors: int, *, idle: bool, differentiable: bool) -> wp.Function:
    """Return the Warp version of ``control.allocation.ThrustsByPriority``, with its arguments and results.

    Traced, its pairs of rotors become straight code, which needs twice the GPU registers
    (``docs/results/independent_checks.md``). A loop step that the compiler does not know keeps the loops. An adjoint needs
    the values of every iteration, which Warp keeps for unrolled loops only; there the step is known.

    Args:
        idle: Whether any rotor has no part in the force along body z.
        differentiable: Whether the adjoint is needed.
    """
    vector, one_type = vector_type(num_rotors), vector_type(1)
    table_type = wp.types.matrix(shape=(num_rotors, 4), dtype=wp.float32)

    @wp.func
    def thrusts_by_priority(
        lift: vector, turn: vector, rest: vector, force: one_type, lowest: vector, highest: vector
    ):  # fmt: skip
        one = 1
        if wp.static(not differentiable):
            one = 1 + int(0.0 * highest[0])
        table = table_type()
        thrust = vector()
        for i in range(0, wp.static(num_rotors), one):
            if lift[i] == 0.0:
                table[i] = wp.vec4(-UNLIMITED, UNLIMITED, 0.0, 0.0)
                thrust[i] = wp.clamp(0.0, lowest[i], highest[i])
            else:
                low = lowest[i] / lift[i]
                high = highest[i] / lift[i]
                table[i] = wp.vec4(wp.min(low, high), wp.max(low, high), turn[i] / lift[i], rest[i] / lift[i])
        shares = wp.vec2()
        for stage in range(0, 2, one):  # roll and pitch, then yaw and lateral force
            share = wp.float32(1.0)
            for i in range(0, wp.static(num_rotors), one):
                if wp.static(idle):
                    change = wp.where(stage == 0, turn[i], rest[i])
                    if lift[i] == 0.0:
                        share = limit_share(share, thrust_margin(lowest[i], highest[i], thrust[i], change), change)
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
                    if wp.static(idle) and lift[i] == 0.0:
                        thrust[i] += share * turn[i]
        collective = float(force[0])
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
            if lift[i] != 0.0:
                thrust[i] = shares[0] * turn[i] + collective * lift[i]
            rest_share = limit_share(rest_share, thrust_margin(lowest[i], highest[i], thrust[i], rest[i]), rest[i])
        allowed = vector()
        for i in range(0, wp.static(num_rotors), one):
            allowed[i] = wp.clamp(thrust[i] + rest_share * rest[i], lowest[i], highest[i])
        return allowed, one_type(shares[0]), one_type(rest_share)

    return thrusts_by_priority


FLOOR, CEILING, SLOPE, TWIST = (wp.constant(column) for column in range(4))
"""Columns of the table of lifting rotors: limits of the force along body z, and the shares of roll and pitch, and of yaw and
lateral force, in it."""


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
