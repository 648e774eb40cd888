"""Thrust, forces and torques of rotors by the flow through them and by nearby surfaces.

Letters: E environments, R rotors.
"""

from math import log, log2, pi

import torch
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.rows import dot, sum_slices
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter
from aerial_gym.physics.effects.condition import Condition, sum_of_crosses
from aerial_gym.physics.effects.induced_flow import AIR_DENSITY, axial_induced_velocity
from aerial_gym.physics.effects.kinds import LinearWrenchEffect, RotorEffect


class RotorInertia(LinearWrenchEffect):
    """Rotor inertia: reaction torque of rotor acceleration on the body, and gyroscopic torque of spinning rotors.

    With the momentum ``h = jr sum s w a`` of rotors of spin s, speed w and axis a, the body feels ``tau = -h' - w_body x
    h``.
    Source: Derived: balance of angular momentum in a turning frame; e.g. Bouabdallah (2007), Design and control of
    quadrotors with application to autonomous flying, section 2.3.
    """

    name = "rotor_inertia"
    summary = "reaction to rotor acceleration, and gyroscopic torque"
    parameters = (Parameter("jr", "kg m²", 0.0, 0.01, 1e-6, "of one rotor about its axis"),)
    excitation = "quick yaw commands, or fast turns with unequal rotor speeds"
    at_hubs = True
    confused_with = ("torque_ratio", "inertia_error")
    rotors = ("reversible", "slew", "dead_band")

    def regressor(self, condition: Condition) -> Tensor:
        """Return (E, 6, 1)."""
        spin = condition.vehicle.rotor_spin[: condition.axis.shape[0]]  # shared if the axes are
        momentum, change = (
            sum_slices((spin * speed).unsqueeze(-1) * condition.axis, 1)
            for speed in (condition.rotor_speed, condition.rotor_acc)
        )
        torque = -change - torch.linalg.cross(condition.ang_vel, momentum)
        return torch.cat((torch.zeros_like(torque), torque), dim=1).unsqueeze(-1)


class HForceFlapping(LinearWrenchEffect):
    """H-force and flapping: in sideways flow a rotor has an in-plane force against the motion, and a moment at its hub.

    For a hub at l with velocity v through the air, its component ``v_e`` in the plane of a rotor of axis a and speed w
    gives ``F = -kh w v_e`` at the hub, and ``tau = l x F + kf w (v_e x a)``: in forward flight the disc tilts back, and
    lifts the nose.
    Source: Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, section "blade flapping"; Hoffmann, Huang, Waslander,
    Tomlin (2007), Quadrotor helicopter flight dynamics and control, section III.B. A lift that is linear in the tip speed
    makes both proportional to w v. A reversed rotor has the opposite axis: its force is against the motion as before, with
    ``|w|``, and its moment changes sign with w, as its disc tilts back about the opposite thrust.
    """

    name = "h_force_flapping"
    summary = "in-plane force and hub moment of rotors in sideways flow"
    parameters = (
        Parameter("kh", "N s²/(m rad)", 0.0, 0.1, 1e-5, "force per speed and velocity"),
        Parameter("kf", "N s²/rad", -0.1, 0.1, 1e-6, "hub moment per speed and velocity"),
    )
    excitation = "sideways velocity in both directions; the moment also needs the rotor speeds one by one"
    at_hubs = True
    confused_with = ("rotor_drag", "com_offset", "constant_wind")
    rotors = ("reversible", "slew", "dead_band")
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return (E, 6, 2), the sums over the rotors."""
        flow = condition.rotor_speed.unsqueeze(-1) * condition.edgewise_velocity
        against = condition.rotor_speed.abs().unsqueeze(-1) * condition.edgewise_velocity
        in_plane = torch.cat((-sum_slices(against, 1), sum_of_crosses(against, condition.lever)), dim=1)
        moment = sum_of_crosses(flow, condition.axis)
        return torch.stack((in_plane, torch.cat((torch.zeros_like(moment), moment), dim=1)), dim=2)


class AxialInflow(RotorEffect):
    """Axial inflow: thrust falls in air from above and grows in air from below.

    ``dT = -ka w v_a`` for a rotor of speed w whose hub moves with v_a along its axis through the air; a roll rate changes
    the thrust of both sides against it and so is damped. A reversed rotor has the opposite axis: both v_a and dT change
    sign, and ``|w|`` replaces w.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 3.3 (blade element in axial flight): the angle
    of attack falls by v_a / (w r), the lift by that times w²; Svacha, Mohta, Kumar (2017), Improving quadrotor trajectory
    tracking by compensating for aerodynamic effects, eq. 6.
    """

    name = "axial_inflow"
    summary = "thrust that falls with the velocity along the rotor axis"
    parameters = (Parameter("ka", "N s²/(m rad)", 0.0, 0.1, 1e-5, "thrust per speed and velocity"),)
    excitation = "climb and descent; roll and pitch rates tell it from a drag along z"
    confused_with = ("rotor_drag", "quadratic_drag", "thrust_coefficient")
    rotors = ("reversible", "slew", "dead_band")
    follows = ("velocity",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``-ka |w| v_a``."""
        return -params[:, :1] * condition.rotor_speed.abs() * condition.axial_velocity


class TranslationalLift(RotorEffect):
    """Translational lift: thrust grows in sideways flow, because a rotor then meets undisturbed air.

    ``dT = kt |v_e|²`` for a rotor whose hub moves at v_e in its own plane through the air.
    Source: Svacha, Mohta, Kumar (2017), Improving quadrotor trajectory tracking by compensating for aerodynamic effects,
    eq. 6; Leishman (2006), Principles of Helicopter Aerodynamics, section 2.14.2 (Glauert's formula, expanded at low
    speed).
    """

    name = "translational_lift"
    summary = "thrust that grows with the square of the velocity in the rotor plane"
    parameters = (Parameter("kt", "N s²/m²", 0.0, 1.0, 0.005, "thrust per velocity squared"),)
    excitation = "several different sideways speeds, some of them high"
    confused_with = ("thrust_coefficient", "quadratic_drag", "payload_mass")
    rotors = ("force", "slew", "dead_band")
    follows = ("velocity",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``kt |v_e|²``."""
        return params[:, :1] * dot(condition.edgewise_velocity, condition.edgewise_velocity)


class ThrustCurve(RotorEffect):
    """Thrust curve: thrust grows by another power of the speed than declared, about that in hover.

    ``T' = T |T / T_h|^(k / 2)`` with the thrust of a rotor in hover ``T_h = m g / R``: on a quadratic thrust map
    ``T' ~ n^(2 + k)`` of the speed n, without a change in hover.
    Source: Derived: a power law through the thrust in hover.
    """

    name = "thrust_curve"
    summary = "thrust that grows by another power of the rotor speed"
    parameters = (Parameter("k", "-", -1.0, 1.0, 0.1, "added to the exponent 2 of the speed"),)
    excitation = "thrusts well above and below that of hover"
    confused_with = ("thrust_coefficient", "axial_inflow", "battery_sag", "payload_mass")
    rotors = ANY_ROTOR
    on_joints = False  # The thrust in hover is that of the whole mass

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T (|T / T_h|^(k / 2) - 1)``."""
        thrust = condition.rotor_thrust
        hover = condition.vehicle.mass.unsqueeze(-1) * (STANDARD_GRAVITY / thrust.shape[-1])
        return thrust * ((thrust.abs() / hover + LEAST_SHARE) ** (0.5 * params[:, :1]) - 1.0)


LEAST_SHARE = 1e-14  # Added to a share of the thrust in hover, for a finite slope without thrust
LOWEST = 0.5  # Least effective height of a hub, in radii
LARGEST_SHARE = 0.5  # Largest share of the thrust due to the ground, which doubles the thrust


class GroundEffect(RotorEffect):
    """Ground effect: rotors near the ground give more thrust at the same speed, because it blocks their wake.

    ``T' = T / (1 - k (R / 4 h)²)`` for a rotor of radius R with its hub at a distance h from the surface in its wake. That
    is the ground for upward thrust, by the sign of T and the axis of the rotor, and the ceiling for downward thrust. The
    other surface has ``ceiling_effect``. The gain vanishes with the thrust, and does not depend on tilt, because the
    sources are for level rotors. k = 1 for a single rotor by the method of images, and larger for several: the source for
    multirotors, with four rotors 3 R apart, gives about 2.5 at a height of 3 R, and 10 with the fountain that lifts the
    body between them. The gain is constant below ``h = R / 2``, where the formula does not hold; thrust is at most doubled.
    Source: Cheeseman, Bennett (1955), The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021;
    factor for multirotors: Sanchez-Cuevas, Heredia, Ollero (2017), Characterization of the aerodynamic ground effect. For
    thrust that points down derived: such a rotor is the mirror image of one over the ground.
    """

    name = "ground_effect"
    summary = "gain of thrust near the ground"
    parameters = (Parameter("k", "-", 0.0, 30.0, 3.0, "strength; 1 is a rotor by itself"),)
    excitation = (
        "flight within two rotor diameters of the ground, and away from it; heights above the ground in the log"
    )
    confused_with = ("thrust_coefficient", "battery_sag", "axial_inflow")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("position",)
    needs = ("position",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T (1 / (1 - s / h²) - 1) = T s / (h² - s)`` with ``s = k (R / 4)²``."""
        radius = condition.vehicle.rotor_radius
        height = condition.wake_room.maximum(LOWEST * radius)
        strength = params[:, :1] * (0.25 * radius).square()
        square = height.square().maximum(strength / LARGEST_SHARE)
        return condition.rotor_thrust * strength / (square - strength)


CLOSEST = 0.5  # Least effective distance of a hub, in radii


class CeilingEffect(RotorEffect):
    """Ceiling effect: rotors close below a ceiling give more thrust at the same speed, because the surface restricts their
    inflow.

    ``T' = T / (1 - k (R / 4 h)²)`` for a rotor of radius R with its hub at a distance h from the surface at its inlet. That
    is the ceiling for upward thrust, by the sign of T and the axis of the rotor, and the ground for downward thrust, as of
    a reversed rotor. The other surface has ``ground_effect``. The gain is constant below ``h = R / 2``, where the formula
    does not hold, and beyond the surface.
    Source: Powers, Mellinger, Kushleyev, Kothmann, Kumar (2013), Influence of aerodynamics and proximity effects in
    quadrotor flight: ``T / T' = 1 - (1 / a_1) (R / (h + a_2))²`` near a ceiling; here a_2 = 0, and ``k = 16 / a_1`` is the
    factor of ``ground_effect``, so that their strengths compare. For thrust that points down derived, as there.
    """

    name = "ceiling_effect"
    summary = "gain of thrust near the ceiling"
    parameters = (Parameter("k", "-", 0.0, 3.5, 1.0, "strength, as of ground_effect"),)
    excitation = "flight within two rotor diameters of the ceiling, and away from it; its height"
    confused_with = ("thrust_coefficient", "battery_sag", "ground_effect")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("position",)
    needs = ("position", "ceiling_height")

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T (1 / (1 - s / h²) - 1) = T s / (h² - s)`` with ``s = k (R / 4)²``."""
        radius = condition.vehicle.rotor_radius
        room = condition.inlet_room.maximum(CLOSEST * radius)
        strength = params[:, :1] * (0.25 * radius).square()
        return condition.rotor_thrust * strength / (room.square() - strength)


CENTRES = (1, 2, 4, 8)  # Distances of a hub from a surface, in radii, at which the parts of a curve have their peaks


def gain_of_curve(room: Tensor, params: Tensor) -> Tensor:
    """Return the relative gain of thrust, (E, R), at distances from a surface in radii, (E, R), for parts of a curve (E, 4).

    Each part is a cubic spline of the logarithm of the distance: 1 at its peak, 1/4 at the peaks beside it, and 0 at a
    quarter and at four times its distance. The gain is constant below half a radius; thrust is at most doubled.
    """
    octave = room.clamp_min(LOWEST).log() / log(2.0)
    gain = torch.zeros_like(room)
    for k, centre in enumerate(CENTRES):
        away = (octave - log2(centre)).abs()
        part = 0.25 * (2.0 - away).clamp_min(0.0) ** 3 - (1.0 - away).clamp_min(0.0) ** 3
        gain = gain + params[:, k : k + 1] * part
    return gain.clamp(-1.0, 1.0)


def _curve_parameters(surface: str) -> tuple[Parameter, ...]:
    meaning = "relative gain of thrust, part at {} radii from the " + surface
    return tuple(Parameter(f"g{centre}", "-", -1.0, 1.0, 0.1, meaning.format(centre)) for centre in CENTRES)


class GroundEffectCurve(GroundEffect):
    """Ground effect by a curve: the gain of thrust at any distance, without a formula, also a loss where flights show one.

    ``T' = T (1 + sum_k g_k B_k(h / R))`` with the parts of ``gain_of_curve``, h as for ``ground_effect``.
    Source: Derived: cubic B-splines (de Boor 1978, A practical guide to splines, ch. IX) of log2(h / R), as thrust may also
    fall above the zone of gain.
    """

    name = "ground_effect_curve"
    summary = "gain or loss of thrust near the ground by a measured curve"
    parameters = _curve_parameters("ground")
    confused_with = ("ground_effect", *GroundEffect.confused_with)
    contains = ("ground_effect",)
    law_of, law = "ground_effect", "curve"

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T sum_k g_k B_k(h / R)``."""
        return condition.rotor_thrust * gain_of_curve(condition.wake_room / condition.vehicle.rotor_radius, params)


class CeilingEffectCurve(CeilingEffect):
    """Ceiling effect by a curve, as ``ground_effect_curve``, of the distance to the surface at the inlet.

    Source: Derived: as ``ground_effect_curve``.
    """

    name = "ceiling_effect_curve"
    summary = "gain of thrust near the ceiling by a measured curve"
    parameters = _curve_parameters("ceiling")
    confused_with = ("ceiling_effect", *CeilingEffect.confused_with)
    contains = ("ceiling_effect",)
    law_of, law = "ceiling_effect", "curve"

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T sum_k g_k B_k(h / R)``."""
        return condition.rotor_thrust * gain_of_curve(condition.inlet_room / condition.vehicle.rotor_radius, params)


LEAST_SQUARE = 1e-6  # Added to the square of the induced velocity [m²/s²], for a finite slope without thrust
LEAST = -8.0  # Fastest descent in the formula, in induced velocities


class VortexRing(RotorEffect):
    """Vortex ring state: a rotor that descends into its own wake loses thrust.

    ``dT = -k T (p(x) - 1) s(y)`` for a rotor of thrust T whose hub moves through the air with ``v_a = x v_h`` along the
    thrust and ``v_e = y v_h`` across it; ``v_h = sqrt(|T| / (2 rho pi R²))``. p(x) is the measured mean induced velocity of
    a descent, and the loss follows its excess over hover: zero in hover and in climb, largest at x = -1.45 with p = 2.09,
    and zero again below x = -2.0055, where p is back at 1 in the windmill brake state. ``s = (1 - y²)²`` below y = 1, else
    0, because sideways flow carries the ring away; the limit of one induced velocity is our choice, near measured
    boundaries.

    k is the loss per excess, from measurements. With ``axial_inflow``, which adds the thrust of air from below, it is at
    most ``sigma a / (8 lambda_h)`` for solidity sigma, lift slope a and inflow lambda_h in hover; with a thrust map alone
    it is the net of both. ``blade_element`` includes p(x) and needs no ``vortex_ring``. Fluctuations of the flow are
    neglected.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.13 (the fit); Shetty, Selig (2011),
    Small-scale propellers operating in the vortex ring state, AIAA 2011-1254 (loss of thrust of small propellers); Johnson
    (2005), Model for vortex ring state influence on rotorcraft flight dynamics, NASA/TP-2005-213477 (that sideways flow
    ends it).
    """

    name = "vortex_ring"
    summary = "loss of thrust in a fast descent into the own wake"
    parameters = (Parameter("k", "-", 0.0, 0.9, 0.1, "relative loss per relative excess of the inflow"),)
    excitation = (
        "steady descents at several rates up to twice the induced velocity of hover, with little sideways speed"
    )
    confused_with = ("axial_inflow", "quadratic_drag", "thrust_coefficient")
    rotors = ANY_ROTOR
    needs_radius = True
    follows = ("velocity",)
    by_default = False

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``-k T (p(x) - 1) s(y)``."""
        thrust, radius = condition.rotor_thrust, condition.vehicle.rotor_radius
        square = thrust.abs() / (2.0 * AIR_DENSITY * pi * radius.square()) + LEAST_SQUARE
        climb = torch.where(thrust < 0.0, -condition.axial_velocity, condition.axial_velocity) / square.sqrt()
        excess = (axial_induced_velocity(climb.clamp(LEAST, 0.0))[0] - 1.0).clamp_min(0.0)
        across = dot(condition.edgewise_velocity, condition.edgewise_velocity) / square
        return -params[:, :1] * thrust * excess * (1.0 - across).clamp_min(0.0).square()
