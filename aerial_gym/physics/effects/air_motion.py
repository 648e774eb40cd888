"""Wind, gusts, the wake of another vehicle, and random pushes. Letters: E environments."""

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.math.random import normal_draws, uniform_draws
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter, SubstepStart
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import WindEffect, WrenchEffect


class ConstantWind(WindEffect):
    """A steady, uniform wind.

    Forces see the velocity through the air, ``v_air = v - wind``. Without any drag in the model a wind changes nothing.
    Source: Derived: Galilean change of frame.
    """

    name = "constant_wind"
    summary = "steady uniform wind; acts through the drag effects"
    parameters = tuple(
        Parameter(axis, "m/s", -40.0, 40.0, 1.0, f"velocity of the air along world {axis}") for axis in "xyz"
    )
    excitation = (
        "a known drag, and headings or attitudes that differ (else a tilted or biased accelerometer looks alike)"
    )
    confused_with = ("rotor_drag", "quadratic_drag", "imu_bias", "com_offset")
    steady = True
    shown_by = ("x", "y")  # An error of thrust or mass looks like a vertical wind, which is near zero above the ground

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the parameters: the same wind at every position."""
        return params


class WindShear(WindEffect):
    """Wind shear: a steady wind that grows with height, as over open land.

    ``wind(h) = (x, y, 0) (h / z_ref)^exponent`` with the height h of the centre of mass over world z = 0; none below it.
    Source: Stull (1988), An Introduction to Boundary Layer Meteorology, section 9.7.5 (power law); 1/7 is usual.
    """

    name = "wind_shear"
    summary = "steady wind that grows with height; acts through the drag effects"
    parameters = (
        Parameter("x", "m/s", -40.0, 40.0, 1.0, "along world x at z_ref"),
        Parameter("y", "m/s", -40.0, 40.0, 1.0, "along world y at z_ref"),
        Parameter("z_ref", "m", 0.1, 100.0, 1.0, "height of reference", neutral=2.0, kind="convention"),
        Parameter("exponent", "-", 0.01, 2.0, 0.2, "power of the height", neutral=1.0 / 7.0),
    )
    excitation = "a known drag, and heights that differ by a factor of two or more"
    confused_with = ("constant_wind", "rotor_drag", "imu_bias")
    contains = ("constant_wind",)
    needs = ("position",)

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air, (E, 3)."""
        x, y, z_ref, exponent = params.unbind(-1)
        height = position[:, 2]
        above = height > 0.0
        relative = torch.where(above, height, z_ref) / z_ref
        gain = torch.where(above, torch.exp(exponent * torch.log(relative)), 0.0)
        return torch.stack((gain * x, gain * y, torch.zeros_like(gain)), dim=-1)


SMALL = 0.01  # Argument below which `1 - exp(-x)` comes from its series, exact in float32 (next term 4e-10 of it)


class Gusts(WindEffect):
    """Gusts: random wind with zero mean, an independent Ornstein-Uhlenbeck process on each axis.

    Near the ground the vertical axis has less intensity and a shorter correlation time: ``vertical`` and ``vertical_time``,
    relative to the horizontal axes. In MIL-F-8785C they are ``q^0.4`` and ``q^1.2``, ``q = 0.177 + 0.0027 h`` at h [m].

    ``dw = -w dt / T + std sqrt(2 / T) dW``, with the variance std² and the autocorrelation ``exp(-|t| / T)``. Over a
    substep ``w' = a w + std sqrt(1 - a²) N(0, 1)``, ``a = exp(-dt / T)``: exact at the ends of substeps of any length;
    within a substep the wind is constant. The first value after a reset is drawn from N(0, std²).
    Source: Gillespie (1996), Exact numerical simulation of the Ornstein-Uhlenbeck process and its integral, eq. 1.9; as a
    model of turbulence it is the longitudinal Dryden spectrum, MIL-F-8785C, section 3.7.
    """

    name = "gusts"
    summary = "random wind with a correlation time; acts through the drag effects"
    parameters = (
        Parameter("std", "m/s", 0.0, 20.0, 1.0, "standard deviation of each axis"),
        Parameter("corr_time", "s", 0.01, 100.0, 1.0, "correlation time T", neutral=1.0),
        Parameter("vertical", "-", 0.0, 20.0, 0.2, "vertical per horizontal std", neutral=1.0, optional=True),
        Parameter("vertical_time", "-", 0.05, 20.0, 0.2, "vertical per horizontal T", neutral=1.0, optional=True),
    )
    excitation = "a known drag, and flights much longer than the correlation time"
    confused_with = ("constant_wind", "downwash")
    memory = (0.0, 0.0, 0.0)  # Wind [m/s], world
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the wind of this substep, (E, 3)."""
        std, corr_time, size, time = (values[:, k : k + 1] for k in range(4))
        share = moment.dt / torch.cat((corr_time, corr_time, corr_time * time), dim=-1)
        begins = (moment.since == 0).unsqueeze(-1)
        decay = torch.where(begins, 0.0, torch.exp(-share))
        spread = torch.cat((std, std, std * size), dim=-1) * torch.where(
            begins, 1.0, (-torch.expm1(-2.0 * share)).sqrt()
        )
        return decay * values[:, 4:] + spread * normal_draws(moment.random, 0, 3, dtype=values.dtype)

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the wind in memory, (E, 3)."""
        return params[:, 4:]


FITTED_WIDTHS = (0.03, 0.1, 0.3, 1.0)
"""Widths of a wake [m] from which fits start. One of them correlates with any width between by 0.91 or more on a pass over
the middle: Gauss curves whose widths have the ratio r correlate by ``sqrt(2 r / (1 + r²))``."""


class Downwash(WrenchEffect):
    """Downwash: the wake of a vehicle above pushes this one down.

    ``F = -force exp(-d² / 2 sigma²)`` along world z at the centre of mass, with the horizontal distance d of the body origins
    of both vehicles, and 0 above the other one. In the simulator the other vehicle is at ``downwash_position`` (GTD), by
    default infinitely high over the environment's origin. Several vehicles of an environment feel one another instead
    (``effects.wakes``).
    Source: Gaussian profile of a developed jet: Pope (2000), Turbulent Flows, section 5.1; such forces between multirotors
    are measured by Shi, Honig, Shi, Yue, Chung (2022), Neural-Swarm2, IEEE T-RO. The decay of the jet with height is left
    out.
    """

    name = "downwash"
    summary = "downward force in the wake of a vehicle above"
    parameters = (
        Parameter("force", "N", 0.0, 100.0, 0.5, "right below the other vehicle"),
        Parameter("sigma", "m", 0.01, 10.0, 0.2, "horizontal width", neutral=0.3),
    )
    excitation = "passes below another vehicle whose position is in the log"
    confused_with = ("gusts", "thrust_coefficient", "ground_effect")
    law = "wake of constant width"
    rotors = ANY_ROTOR
    follows = ("position",)
    needs = ("position", "other_position")
    shown_by = ("force",)  # Without it the width means nothing

    def starts(self, robot: RobotCfg) -> list[tuple[float, ...]]:
        """Return starts without force at several widths: a fit from a wide wake misses a narrow one."""
        return super().starts(robot) if self.in_place else [(0.0, width) for width in FITTED_WIDTHS]

    def share(self, square: Tensor, below: Tensor, params: Tensor) -> Tensor:
        """Return the force as a share of ``force``, (E,), at a squared horizontal distance and a distance below, (E,)."""
        del below
        return torch.exp(-0.5 * square / params[:, 1].square())

    def push(self, away: Tensor, params: Tensor) -> Tensor:
        """Return the downward force [N], (E,), in the wake of a vehicle ``away`` [m], world, (E, 3)."""
        below = away[:, 2]
        share = torch.where(below > 0.0, self.share(away[:, :2].square().sum(-1), below, params), 0.0)
        return params[:, 0] * share

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque (E, 6)."""
        origin = condition.position - quat_rotate(condition.attitude, condition.vehicle.com)
        force = -self.push(condition.other_position - origin, params).unsqueeze(-1) * condition.up
        return torch.cat((force, torch.zeros_like(force)), dim=-1)


NEAREST = 0.3  # Least distance below the other vehicle in the formula of the jet [m]
FARTHEST = 1e6  # Greatest one: there is no wake


class DownwashJet(Downwash):
    """Downwash as a turbulent jet, which widens and slows with the distance below the other vehicle.

    ``F = -force (1 m / z)² exp(-(d / (spread z))²)`` for a distance z below and d beside it, as the dynamic pressure of a
    round jet; z is at least 0.3 m.
    Source: Jain, Fortmuller, Byun, Makiharju, Mueller (2019), Modeling of aerodynamic disturbances for proximity flight of
    multirotors, ICUAS; decay and width of the jet: Pope (2000), Turbulent Flows, section 5.1.
    """

    name = "downwash_jet"
    summary = "downward force in the wake of a vehicle above, which widens and slows below it"
    parameters = (
        Parameter("force", "N", 0.0, 100.0, 0.5, "1 m below the other vehicle"),
        Parameter("spread", "-", 0.01, 2.0, 0.1, "horizontal width per distance below", neutral=0.2),
    )
    law_of, law, in_place = "downwash", "turbulent jet", True

    def share(self, square: Tensor, below: Tensor, params: Tensor) -> Tensor:
        """Return the share, (E,)."""
        height = below.clamp(NEAREST, FARTHEST).square()
        return torch.exp(-square / (params[:, 1].square() * height)) / height


class DownwashCore(Downwash):
    """Downwash with a core of even speed and a steeper edge, as close below a rotor.

    ``F = -force exp(-(d / sigma)^power / 2)``: 2 is the Gaussian of ``downwash``, and a large power a slipstream of radius
    sigma.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2 (slipstream of momentum theory); the edge
    derived: a power between this slipstream and a Gaussian.
    """

    name = "downwash_core"
    summary = "downward force in the wake of a vehicle above, with an even core"
    parameters = (*Downwash.parameters, Parameter("power", "-", 1.0, 40.0, 1.0, "of the edge", neutral=2.0))
    contains = ("downwash",)
    law_of, law, in_place = "downwash", "wake with an even core", True

    def share(self, square: Tensor, below: Tensor, params: Tensor) -> Tensor:
        """Return the share, (E,)."""
        del below
        distance = square / params[:, 1].square()
        return torch.exp(-0.5 * (distance + SMALLEST) ** (0.5 * params[:, 2]))


SMALLEST = 1e-12  # Added to a squared distance in widths, for a finite slope at the centre


def _begins(moment: SubstepStart, hold: Tensor) -> Tensor:
    """Return whether an interval of ``hold`` [s] begins: at the first substep that ends over half a substep after it, (E,)."""
    share = moment.dt / hold
    since = moment.since.to(hold.dtype)
    return (moment.since == 0) | (((since + 0.5) * share).floor() > ((since - 0.5) * share).floor())


class RandomForce(WrenchEffect):
    """Random force: uniform in a box along the world axes, drawn independently at regular intervals.

    ``F_i`` is uniform in -f_i to f_i, at the centre of mass, and constant for T. The velocity change within a time t of
    many intervals has the standard deviation ``f_i sqrt(t T / 3) / m`` on each axis. A new interval begins at the first
    substep that ends more than half a substep after the old one's end; T is at least a substep.
    Source: Derived: the variance of a uniform draw is ``f² / 3``, and those of t / T independent impulses ``F T`` add up.
    As a disturbance it is that of github learnsyslab/lsy_drone_racing (envs/race_core.py): 0.1 N, 500 times a second.
    """

    name = "random_force"
    summary = "random force, uniform in a box, drawn anew at even intervals"
    parameters = (
        *(Parameter(axis, "N", 0.0, 100.0, 0.1, f"largest force along world {axis}") for axis in "xyz"),
        Parameter("hold", "s", 0.0001, 100.0, 0.002, "interval T between two draws", neutral=0.002),
    )
    excitation = "flights much longer than the interval"
    confused_with = ("gusts",)
    rotors = ANY_ROTOR
    memory = (0.0, 0.0, 0.0)  # Force [N], world
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the force of this substep, (E, 3)."""
        # Index 1 separates these draws from those of `gusts` in the same substep
        drawn = values[:, :3] * (2.0 * uniform_draws(moment.random, 1, 3, dtype=values.dtype) - 1.0)
        return torch.where(_begins(moment, values[:, 3]).unsqueeze(-1), drawn, values[:, 4:])

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the force in memory in body axes, without torque, (E, 6)."""
        force = quat_rotate_inverse(condition.attitude, params[:, 4:])
        return torch.cat((force, torch.zeros_like(force)), dim=-1)


class RandomPush(WrenchEffect):
    """Random pushes: at regular intervals a force and a torque act with a probability, both uniform in a box of body axes.

    ``F_i`` and ``M_i`` are uniform in -f_i to f_i and -m_i to m_i with the probability p, else 0; both are constant for the
    interval T, as in ``random_force``. The impulse of an interval has the variance ``p f_i² T² / 3`` on each axis.
    Source: github ntnu-arl/aerial_gym_simulator (robots/base_multirotor.py): pushes drawn in each physics step, at the origin
    of the root link. Here they act at the centre of mass.
    """

    name = "random_push"
    summary = "random force and torque at random moments, uniform in a box of body axes"
    parameters = (
        *(Parameter(f"force_{axis}", "N", 0.0, 100.0, 0.1, f"largest force along body {axis}") for axis in "xyz"),
        *(Parameter(f"torque_{axis}", "N m", 0.0, 10.0, 0.01, f"largest torque about body {axis}") for axis in "xyz"),
        Parameter("probability", "-", 0.0, 1.0, 0.1, "of a push in an interval"),
        Parameter("hold", "s", 0.0001, 100.0, 0.002, "interval T between two draws", neutral=0.002),
    )
    excitation = "flights much longer than the interval"
    confused_with = ("gusts", "random_force")
    rotors = ANY_ROTOR
    memory = (0.0,) * 6  # Force [N] and torque [N m], body axes
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return force and torque of this substep, (E, 6)."""
        draws = uniform_draws(
            moment.random, 2, 7, dtype=values.dtype
        )  # 0 and 1 are those of `gusts` and `random_force`
        acts = draws[:, 6:] < values[:, 6:7]
        pushes = torch.where(acts, values[:, :6] * (2.0 * draws[:, :6] - 1.0), 0.0)
        return torch.where(_begins(moment, values[:, 7]).unsqueeze(-1), pushes, values[:, 8:])

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque in memory, (E, 6)."""
        return params[:, 8:]
