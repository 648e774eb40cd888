"""Induced velocity of a rotor in climb, descent and sideways flow.

In units of the induced velocity of hover ``v_h``, at the climb rate ``x = v_a / v_h`` along the thrust::

    p(x) = 1 / (x / 2 + sqrt(x² / 4 + 1))           x >= 0         momentum theory, climb
    p(x) = 1 + k1 x + k2 x² + k3 x³ + k4 x⁴          X_w < x < 0    measured: descent through the vortex ring
    p(x) = 1 / (-x / 2 + sqrt(x² / 4 - 1))          x <= X_w       momentum theory, windmill brake

The fit is valid for -2 < x < 0 and ends there at 1.026, where momentum theory begins at 1 with infinite slope. Fit and theory
meet at ``X_w = -2.042``, the switch that makes p continuous. Momentum theory alone has no solution between, because the wake
does not leave the rotor. The fit is the mean of an unsteady flow, whose fluctuation is neglected.

With sideways speed ``y = v_e / v_h`` the induced velocity f solves ``f² (y² + (f / p²)²) = 1``: exactly p(x) for y = 0, exactly
Glauert's ``f² (y² + f²) = 1`` for x = 0, and ``1 / y`` at high speed. Between, for climbs of up to 2 v_h, it is within 10 % of
``f² (y² + (x + f)²) = 1``.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, sections 2.13 (climb, windmill brake, and the fit, with the
induced velocity of hover as unit) and 2.14 (Glauert). The joint formula for x and y is our own.
"""

import torch
from torch import Tensor

AIR_DENSITY = 1.225  # Of the standard atmosphere at sea level [kg/m³] (ISO 2533)
DESCENT_FIT = (-1.125, -1.372, -1.718, -0.655)  # k1 to k4
WINDMILL = -2.042327301921998  # X_w


def axial_induced_velocity(climb: Tensor) -> tuple[Tensor, Tensor]:
    """Return the induced velocity p(x) and its slope in x, in units of that of hover, for climb rates x likewise."""
    k1, k2, k3, k4 = DESCENT_FIT
    fit = 1.0 + climb * (k1 + climb * (k2 + climb * (k3 + climb * k4)))
    fit_slope = k1 + climb * (2.0 * k2 + climb * (3.0 * k3 + climb * 4.0 * k4))
    measured, sign = (climb < 0.0) & (climb > WINDMILL), torch.where(climb <= WINDMILL, -1.0, 1.0)
    half = 0.5 * torch.where(measured, 0.0, climb).abs()
    root = (half.square() + sign).sqrt()  # climb and windmill brake state in one formula
    theory = 1.0 / (half + root)
    return torch.where(measured, fit, theory), torch.where(measured, fit_slope, -0.5 * sign * theory / root)


def induced_velocity(hover: Tensor, climb: Tensor, edgewise: Tensor) -> tuple[Tensor, Tensor]:
    """Return the induced velocity and its slope in that of hover; all velocities in one unit, > 0 for ``hover``.

    Args:
        hover: Induced velocity of the same thrust in hover, v_h.
        climb: Velocity of the rotor through the air along its thrust.
        edgewise: Its size in the plane of the rotor.
    """
    ratio = climb / hover
    axial, slope = axial_induced_velocity(ratio)
    square = edgewise.square()
    fourth = 4.0 * (hover / axial).square().square()
    root = (square.square() + fourth).sqrt()
    value = hover.square() * (2.0 / (square + root)).sqrt()
    growth = 2.0 - fourth / (root * (square + root)) * (1.0 + ratio * slope / axial)  # d ln value / d ln hover
    return value, value / hover * growth
