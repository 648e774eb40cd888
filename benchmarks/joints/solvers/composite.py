"""A link with all that it carries as one rigid body, in Warp.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 2.13 (inertia about another point) and 6.2.
"""

import warp as wp


@wp.struct
class Composite:
    """All that a link carries and itself as one rigid body, about its origin; its mass is a number in the code."""

    moment: wp.vec3  # mass times centre [kg m]
    diagonal: wp.vec3  # of the inertia, xx, yy, zz [kg m²]
    beside: wp.vec3  # yz, xz, xy
    torque: wp.vec3  # what it takes while joints and base do not accelerate [N m]
    force: wp.vec3  # [N]


@wp.func
def together(a: Composite, b: Composite) -> Composite:
    """Return both as one."""
    both = Composite()
    both.moment = a.moment + b.moment
    both.diagonal = a.diagonal + b.diagonal
    both.beside = a.beside + b.beside
    both.torque = a.torque + b.torque
    both.force = a.force + b.force
    return both


@wp.func
def shifted(of: Composite, mass: float, lever: wp.vec3) -> Composite:
    """Return it about another origin, from which the first one is ``lever`` away."""
    after = Composite()
    half = of.moment + (0.5 * mass) * lever
    square = 2.0 * wp.dot(half, lever)
    after.moment = of.moment + mass * lever
    after.diagonal = of.diagonal + wp.vec3(square, square, square) - 2.0 * wp.cw_mul(half, lever)
    after.beside = of.beside - wp.vec3(
        half[1] * lever[2] + half[2] * lever[1],
        half[0] * lever[2] + half[2] * lever[0],
        half[0] * lever[1] + half[1] * lever[0],
    )
    after.torque = of.torque + wp.cross(lever, of.force)
    after.force = of.force
    return after


@wp.func
def turned_by(of: Composite, axis: wp.vec3) -> wp.vec3:
    """Return the torque that an angular acceleration takes."""
    return wp.cw_mul(of.diagonal, axis) + wp.vec3(
        of.beside[2] * axis[1] + of.beside[1] * axis[2],
        of.beside[2] * axis[0] + of.beside[0] * axis[2],
        of.beside[1] * axis[0] + of.beside[0] * axis[1],
    )
