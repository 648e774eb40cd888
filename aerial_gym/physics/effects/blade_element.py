"""Blades of rotors in their inflow. Letters: E environments, R rotors."""

from math import pi

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.math.rows import apply_by_element, choose, dot, sum_slices
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.induced_flow import AIR_DENSITY, induced_velocity
from aerial_gym.physics.effects.kinds import WrenchEffect
from aerial_gym.physics.rotor_maps import rotor_loads, rotor_state_for_thrust

HALVINGS, NEWTON = 6, 3
"""Iterations of the search for the inflow. Its equation has one root, as the induced velocity grows with the thrust. Newton's
method starts at the solution without sideways speed (of hover, if the rotor sinks). In a fast descent, where it may diverge,
bisection brackets the root first. The final error is below 1e-4 of the inflow of hover."""

FAST = 0.8  # Descent rate, as a share of the induced velocity of hover, above which bisection comes first
SLOWEST = 1.0  # Least rotor speed in the formulas [rad/s]
LEAST = 1e-6  # Least thrust coefficient in hover, least induced velocity, least square of the velocity per tip speed
SHARE, SOLIDITY, SLOPE, TWIST, LOCK, FLAP = range(6)
SOLIDITY_OF_TWO_BLADES = 0.1  # Area of the blades per area of the disc of a plastic propeller with two blades
KINEMATIC_VISCOSITY = 1.461e-5  # Of the standard atmosphere at sea level [m²/s] (ISO 2533)
REFERENCE_SLOPE, REFERENCE_REYNOLDS = 3.3, 5e4  # Lift slope [1/rad] at a Reynolds number, by three propellers' climbs

REYNOLDS_EXPONENT = 0.11
"""Exponent of the lift slope in the Reynolds number. Static thrust of 136 propellers goes with the speed to the power 2.09
(``tests/measured/test_bench.py``), thus its coefficient with the Reynolds number to the power 0.09. By the equation of C_T at
rest the slope to the power 0.8 is in the coefficient: ``d ln C_T / d ln a = (Theta - lambda / 2) / (Theta - lambda / 4)``."""


def lift_slope(reynolds: float) -> float:
    """Return the lift slope [1/rad] of blades at the Reynolds number of chord and speed at 3/4 of the radius."""
    return REFERENCE_SLOPE * (reynolds / REFERENCE_REYNOLDS) ** REYNOLDS_EXPONENT


def reynolds_number(speed: float, radius: float, chord: float) -> float:
    """Return the Reynolds number at 3/4 of the radius [m], of a chord [m] there, at a rotor speed [rad/s]."""
    return 0.75 * radius * speed * chord / KINEMATIC_VISCOSITY


class BladeElement(WrenchEffect):
    """Blade-element model of rotors in a uniform inflow from momentum theory.

    The effect adds the forces of blades in moving air to the static maps of the robot file. A rotor of speed w moves
    through the air with ``lambda_c`` along its thrust n and with the vector m, of size mu, in its plane, both in units of
    its tip speed w R. Forces are in units of ``rho pi R² (w R)²``, torques of that times R; 0 marks hover at the same w::

        C_T = s a / 2 (Theta + mu² T / 2 - lambda / 2),  Theta = t0 / 3 + t1 / 4,  T = t0 + t1 / 2,  lambda = lambda_c+lambda_i
        b_c = -8 g² (1 + mu² / 2) m_s / d,  b_s = 8 g k m_s / d,    d = k² + g² (1 - mu⁴ / 4),  m_s = Theta - lambda / 4
        g = lock / 8,   k = (flap_frequency / w)²
        C_H = s a / 2 (lambda T / 2 - b_c (Theta - 3/4 lambda) + mu² b_c² / 4) + 2 P0
        C_Y = s a / 2 b_s (3/4 lambda - Theta + mu² (b_c / 4 - T / 2))
        C_Q = lambda C_T + P0 (1 + 3 mu²) - mu² C_H,        P0 = C_Q0 - lambda_0 C_T0

    for blades of solidity s, lift slope a, and pitch ``t0 + t1 r`` at the relative radius r, without stall. They flap by
    ``mu (b_c cos psi + b_s sin psi)``, with psi from downstream. ``-b_c C_T`` is the thrust component of the tilted disc;
    ``b_c s a lambda / 8`` of it is lost, as flapping changes the drag in the plane. The pitch follows from the thrust map
    (``Theta = 2 C_T0 / (s a) + lambda_0 / 2``) and the profile drag from the torque map (P0), so a vehicle at rest in still
    air is as declared. ``lambda_i`` is that of ``induced_flow`` for the thrust C_T. The force on the hub is

        C_T n - C_H m + o C_Y (m x n)      o = +1 where the rotor turns counter-clockwise about n, else -1

    and the hub feels the drag torque ``-o C_Q n`` and the moment of blades that resist their flapping, ``-s a / 2 k / (8 g)
    (b_c m x n + o b_s m)``. Stiff blades (k >> g) pass the lift of the advancing side on as a moment to the side, hinged
    ones (k = 0) lean back. Power is in balance, ``C_Q + mu² C_H = lambda C_T + P0 (1 + 3 mu²)``. The integrals over radius
    and azimuth are exact for small angles and this flapping. Between hover and the windmill brake state the induced
    velocity is the measured mean of the vortex ring (``induced_flow``); thrust against n has no induced velocity. Left out:
    reverse flow and stall (beyond mu = 1 or ``|lambda_c|`` = 1 coefficients stay what they are there), coning, which also
    depends on how blades are built, higher harmonics of flapping, a lag of the inflow, its slope across the disc, tip loss,
    and turning of the hub but for its velocity.

    In a climb only the product s a matters, with s from the chord at 3/4 of the radius. ``lift_slope`` gives a by the
    Reynolds number: 3.3 at 50,000, by the loss of thrust of three tested propellers (``docs/results/propellers.md``), not
    the 5.7 of a thin section, because blades are short, slow and partly stalled at rest.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, sections 3.2-3.3, 4.5 (flapping), 5.2; Johnson (1980),
    Helicopter Theory, chapter 5; Bramwell, Done, Balmford (2001), Bramwell's Helicopter Dynamics, chapter 3; of small
    propellers Gill, D'Andrea (2017), Propeller thrust and drag in forward flight, IEEE CCTA. Forces and flapping: derived,
    by integration of ``s a / 2 (theta U_T² - U_P U_T)`` and ``s a / 2 (theta U_T - U_P) U_P``. Climbs: UIUC propeller
    database (Brandt, Deters, Ananda, Selig).
    """

    name = "blade_element"
    summary = "blades in their inflow: thrust, H-force, torque and flapping in climb, descent and sideways flow"
    parameters = (
        Parameter("share", "-", 0.0, 2.0, 0.3, "share of the model; 1 is full strength"),
        Parameter("solidity", "-", 0.01, 0.6, 0.03, "area of the blades per area of the disc", kind="convention"),
        Parameter("lift_slope", "1/rad", 1.0, 7.0, 0.5, "of a section", kind="convention"),
        Parameter("twist", "rad", -1.0, 0.0, 0.1, "pitch at the tip less that at the axis", kind="convention"),
        Parameter(
            "lock",
            "-",
            0.01,
            20.0,
            0.2,
            "Lock number: rho a c R⁴ over the inertia of a blade in flapping",
            kind="convention",
        ),
        Parameter(
            "flap_frequency",
            "rad/s",
            0.0,
            1e5,
            100.0,
            "of the first bending of a blade at rest; 0: a free hinge",
            kind="convention",
        ),
    )
    excitation = "fast flight, climbs and descents, in still air or a known wind"
    at_hubs = True
    confused_with = ("axial_inflow", "translational_lift", "h_force_flapping", "rotor_drag")
    rotors = ("reversible", "slew", "dead_band")
    follows = ("velocity",)
    needs_radius = True
    by_default = False

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return share 0, with a two-bladed plastic propeller as in the sources of ``docs/results/propellers.md``."""
        return 0.0, SOLIDITY_OF_TWO_BLADES, _slope_at_hover(robot), -0.45, 0.4, 900.0

    def check(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` unless radii are known and drag torques exceed those of an ideal rotor."""
        super().check(robot)
        share = robot.body.mass * STANDARD_GRAVITY / robot.num_rotors
        for rotor in robot.rotor_types:
            assert rotor.radius is not None
            speed = rotor_state_for_thrust(rotor, share)
            thrust, torque = rotor_loads(rotor, speed)
            ideal = thrust * (thrust / (2.0 * AIR_DENSITY * pi * rotor.radius**2)) ** 0.5 / speed
            if not torque > ideal:
                raise ConfigError(
                    f"effect blade_element: a rotor of radius {rotor.radius:g} m that gives {thrust:.3g} N at {speed:.4g} "
                    f"rad/s has a drag torque of at least {ideal:.3g} N m, and the robot file says {torque:.3g}. Check radius "
                    "and torque map"
                )

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque, (E, 6)."""
        share, solidity, slope, twist, lock, flap = params[:, : FLAP + 1].unsqueeze(-2).unbind(-1)
        speed, radius, vehicle = condition.rotor_speed, condition.vehicle.rotor_radius, condition.vehicle
        turns_back = speed < 0.0
        sign = torch.where(turns_back, -torch.ones_like(speed), torch.ones_like(speed))
        rate = speed.abs().clamp_min(SLOWEST)
        tip = rate * radius
        unit = AIR_DENSITY * pi * (radius * tip).square()
        flow = condition.edgewise_velocity / tip.unsqueeze(-1)
        size = (dot(flow, flow) + LEAST * LEAST).sqrt()
        flow = flow / size.clamp_min(1.0).unsqueeze(-1)
        mu = size.clamp_max(1.0)
        climb = (sign * condition.axial_velocity / tip).clamp(-1.0, 1.0)
        lift = solidity * slope
        hover_thrust = (sign * condition.rotor_thrust / unit).clamp_min(LEAST)
        hover_torque = sign * condition.rotor_drag_torque / (unit * radius)
        hover_inflow = (0.5 * hover_thrust).sqrt()
        theta = 2.0 * hover_thrust / lift + 0.5 * hover_inflow
        root = 3.0 * (theta - 0.25 * twist)
        lifted = theta + mu.square() * (0.5 * root + 0.25 * twist)
        inflow = climb + apply_by_element(_inflow, lift, lifted, climb, mu)
        thrust = 0.5 * lift * (lifted - 0.5 * inflow)
        profile = hover_torque - hover_inflow * hover_thrust
        square, g, k = mu.square(), 0.125 * lock, (flap / rate).square()
        whole, uneven, tilted = root + 0.5 * twist, theta - 0.25 * inflow, theta - 0.75 * inflow
        resists = uneven / (k * k + g * g * (1.0 - 0.25 * square.square()))
        back, aside = -resists * g * (1.0 + 0.5 * square), resists * k  # b_c / (8 g), b_s / (8 g)
        b_c, b_s = 8.0 * g * back, 8.0 * g * aside
        drag = 0.5 * lift * (0.5 * inflow * whole - b_c * tilted + 0.25 * square * b_c.square()) + 2.0 * profile
        side = 0.5 * lift * b_s * (square * (0.25 * b_c - 0.5 * whole) - tilted)
        torque = inflow * thrust + profile * (1.0 + 3.0 * square) - square * drag
        stiff = 0.5 * lift * k * unit * radius
        way = sign.unsqueeze(-1) * condition.axis
        across = torch.linalg.cross(flow, way, dim=-1)
        spin = vehicle.rotor_spin
        force = (unit * (thrust - hover_thrust)).unsqueeze(-1) * way - (unit * drag).unsqueeze(-1) * flow
        force = force + (unit * spin * side).unsqueeze(-1) * across
        moment = -(stiff * back).unsqueeze(-1) * across - (stiff * spin * aside).unsqueeze(-1) * flow
        moment = moment - (spin * unit * radius * (torque - hover_torque)).unsqueeze(-1) * way
        moment = moment + torch.linalg.cross(condition.lever.expand_as(force), force, dim=-1)
        return share * torch.cat((sum_slices(force, 1), sum_slices(moment, 1)), dim=-1)


def _slope_at_hover(robot: RobotCfg) -> float:
    """Return the lift slope [1/rad] of two blades at hover, of the first rotor; that of the reference without a radius."""
    rotor = robot.rotor_types[0]
    if rotor.radius is None or rotor.mode == "force":
        return REFERENCE_SLOPE
    speed = rotor_state_for_thrust(rotor, robot.body.mass * STANDARD_GRAVITY / robot.num_rotors)
    return lift_slope(reynolds_number(speed, rotor.radius, 0.5 * SOLIDITY_OF_TWO_BLADES * pi * rotor.radius))


def _inflow(lift: Tensor, lifted: Tensor, climb: Tensor, mu: Tensor) -> Tensor:
    """Return the induced velocity from the balance of momentum and blades: ``2 v² = lift / 2 (lifted - (climb + f(v)) / 2)``.

    Args:
        lift: Solidity times lift slope, (E, 1).
        lifted: ``2 C_T / lift`` at no inflow, (E, R).
        climb: Climb rate per tip speed, (E, R).
        mu: Sideways speed per tip speed, (E, R).

    Returns:
        f(v), per tip speed, (E, R); v is the induced velocity of the same thrust in hover.
    """
    with torch.no_grad():
        low = torch.zeros_like(mu)
        high = (0.25 * lift * (lifted + 0.5 * climb.abs())).clamp_min(LEAST).sqrt()
        rising = climb.clamp_min(0.0)
        linear = 0.125 * lift - rising
        whole = 0.5 * ((linear.square() + lift * lifted).clamp_min(0.0).sqrt() - linear)
        start = (whole * (whole - rising)).clamp_min(LEAST * LEAST).sqrt().minimum(high)
        falls = climb < -FAST * start
        hover_induced = choose(falls, _bisect_inflow, start, high, lift, lifted, climb, mu)
        half = 0.5 ** (HALVINGS + 1) * high
        low, high = torch.where(falls, hover_induced - half, low), torch.where(falls, hover_induced + half, high)
    value = hover_induced
    for _ in range(NEWTON):
        missing, slope, value, growth = _inflow_residual(hover_induced, lift, lifted, climb, mu)
        with torch.no_grad():
            above = missing >= 0.0
            low, high = torch.where(above, low, hover_induced), torch.where(above, hover_induced, high)
        after = (hover_induced - missing / slope).maximum(low).minimum(high).clamp_min(LEAST)
        value, hover_induced = value + growth * (after - hover_induced), after
    return value


def _bisect_inflow(high: Tensor, lift: Tensor, lifted: Tensor, climb: Tensor, mu: Tensor) -> Tensor:
    """Return the middle of an interval with the root, which is ``2^-HALVINGS`` of the one from 0 to ``high``."""
    bottom, top = torch.zeros_like(high), high
    for _ in range(HALVINGS):
        middle = 0.5 * (bottom + top)
        above = _inflow_residual(middle, lift, lifted, climb, mu)[0] >= 0.0
        bottom, top = torch.where(above, bottom, middle), torch.where(above, middle, top)
    return 0.5 * (bottom + top)


def _inflow_residual(
    hover_induced: Tensor, lift: Tensor, lifted: Tensor, climb: Tensor, mu: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the residual of momentum and blades, ``2 v² - C_T``, its slope in v, and the induced velocity f(v) and slope."""
    value, slope = induced_velocity(hover_induced, climb, mu)
    missing = 2.0 * hover_induced.square() - 0.5 * lift * (lifted - 0.5 * (climb + value))
    return missing, 4.0 * hover_induced + 0.25 * lift * slope, value, slope
