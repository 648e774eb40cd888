"""Articulated inertia of a link with all links that it carries, in Warp."""

import warp as wp


@wp.struct
class Inertia:
    """Articulated inertia of a link with all links that it carries, about its origin, and its bias wrench."""

    turn: wp.mat33  # torque per angular acceleration [kg m²]
    mixed: wp.mat33  # torque per acceleration [kg m]; transposed, force per angular acceleration
    push: wp.mat33  # force per acceleration [kg]
    torque: wp.vec3  # [N m]
    force: wp.vec3  # [N]


@wp.func
def symmetric_matrix(of: wp.mat33) -> wp.mat33:
    """Return a symmetric matrix from its upper half, to avoid duplicate computations."""
    return wp.mat33(of[0, 0], of[0, 1], of[0, 2], of[0, 1], of[1, 1], of[1, 2], of[0, 2], of[1, 2], of[2, 2])


@wp.func
def skew_product(lever: wp.vec3, of: wp.mat33) -> wp.mat33:
    """Return ``skew(lever) of``, without the products with zeros."""
    return wp.matrix_from_cols(
        wp.cross(lever, wp.vec3(of[0, 0], of[1, 0], of[2, 0])),
        wp.cross(lever, wp.vec3(of[0, 1], of[1, 1], of[2, 1])),
        wp.cross(lever, wp.vec3(of[0, 2], of[1, 2], of[2, 2])),
    )


@wp.func
def sum_of_inertias(a: Inertia, b: Inertia) -> Inertia:
    """Return the sum of two inertias."""
    both = Inertia()
    both.turn = a.turn + b.turn
    both.mixed = a.mixed + b.mixed
    both.push = a.push + b.push
    both.torque = a.torque + b.torque
    both.force = a.force + b.force
    return both


@wp.func
def rigid_inertia(mass: float, com: wp.vec3, about: wp.mat33, ang_vel: wp.vec3, lin_vel: wp.vec3) -> Inertia:
    """Return the inertia of one rigid link.

    Args:
        mass: [kg].
        com: Centre of mass from the link's origin [m].
        about: Inertia about it, axes of the base [kg m²].
        ang_vel: Of the link [rad/s].
        lin_vel: Of its origin [m/s].
    """
    own = Inertia()
    own.turn = symmetric_matrix(about + mass * (wp.length_sq(com) * wp.identity(n=3, dtype=float) - wp.outer(com, com)))
    own.mixed = mass * wp.skew(com)
    own.push = mass * wp.identity(n=3, dtype=float)
    momentum = mass * (lin_vel + wp.cross(ang_vel, com))
    spin = own.turn * ang_vel + mass * wp.cross(com, lin_vel)
    own.torque = wp.cross(ang_vel, spin) + wp.cross(lin_vel, momentum)
    own.force = wp.cross(ang_vel, momentum)
    return own


@wp.func
def add_acceleration(own: Inertia, mass: float, com: wp.vec3, bend: wp.vec3, swing: wp.vec3) -> Inertia:
    """Return the inertia of one rigid link with its own velocity-dependent acceleration.

    Args:
        own: Result of ``rigid_inertia``.
        mass: [kg].
        com: Centre of mass from the link's origin [m].
        bend: Angular acceleration [rad/s²].
        swing: Acceleration of its origin [m/s²].
    """
    after = own
    push = mass * (swing + wp.cross(bend, com))
    after.torque += own.turn * bend + mass * wp.cross(com, swing)
    after.force += push
    return after


@wp.func
def add_inertia(own: Inertia, push: wp.mat33, turn: wp.mat33, com: wp.vec3) -> Inertia:
    """Add further inertia at a centre of mass.

    Args:
        own: Inertia of a link.
        push: Force per acceleration of the centre [kg].
        turn: Torque per angular acceleration [kg m²].
        com: The centre from the link's origin [m].
    """
    mixed = wp.skew(com) * push
    after = own
    after.push += push
    after.mixed += mixed
    after.turn += turn - mixed * wp.skew(com)
    return after


@wp.func
def center_of_mass(own: Inertia) -> wp.vec3:
    """Return the centre of mass of one rigid link from its origin [m]."""
    return (1.0 / own.push[0, 0]) * wp.vec3(own.mixed[2, 1], own.mixed[0, 2], own.mixed[1, 0])


@wp.func
def shift_inertia(of: Inertia, lever: wp.vec3) -> Inertia:
    """Shift an inertia to another origin, from which the first is at ``lever``."""
    after = Inertia()
    after.mixed = of.mixed + skew_product(lever, of.push)
    turned = of.turn + skew_product(lever, wp.transpose(of.mixed))
    after.turn = symmetric_matrix(turned + wp.transpose(skew_product(lever, wp.transpose(after.mixed))))
    after.push = of.push
    after.torque = of.torque + wp.cross(lever, of.force)
    after.force = of.force
    return after
