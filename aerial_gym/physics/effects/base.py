"""Base class of all physical effects, shared by simulation and identification.

An effect is one class. It states its parameters with unit, bounds and neutral value, its formula, the excitation that makes
it visible, and the effects it can be confused with. Its kind (``effects.kinds``) states where it enters a step.
Parameters are per environment, (E, P). Frames: body is x forward, y left, z up; world is z up.
"""

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.math.decay import sum_with_decay
from aerial_gym.physics.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RotorSpeedsOfFlight:
    """Rows of one flight at equal time steps."""

    vehicle: Vehicle  # With the effects on its parameters applied, one environment
    rotor_speed: Tensor  # True rotor speeds [rad/s], (T, R)
    step: float  # Time between two rows [s]
    voltage: Tensor | None = None  # Logged battery voltage [V], (T,)
    begins_on_ground: bool  # Whether the vehicle is on the ground in the first row
    settled: float = 1.0  # Initial memory of a flight that begins in the air, per steady value in hover


def relax(rest: Array, start: Array, *, tau: float, step: float) -> Array:
    """Return the response of first-order elements to steady states given every ``step`` [s], both (T, any).

    ``h_n+1 = a h_n + b0 r_n + b1 r_n+1`` with ``x = step / tau``, ``a = exp(-x)``, ``b1 = 1 - (1 - a) / x``,
    ``b0 = 1 - a - b1``: exact for r linear between the rows. ``start`` is h in the first row, (any,).

    Source:
        Derived: ``tau h' = r - h`` with a linear r, integrated over a step.
    """
    share = step / tau
    decay, gained = np.exp(-share), -np.expm1(-share)
    later = 1.0 - gained / share
    return sum_with_decay(np.concatenate((start[None], (gained - later) * rest[:-1] + later * rest[1:])), float(decay))


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect."""

    name: str  # Short name, as in robot files and verdicts
    unit: str  # SI unit
    low: float  # Lowest value that is physically possible
    high: float  # Highest value that is physically possible
    scale: float  # A change that one would call moderate: the step of numerical derivatives and fits
    meaning: str  # One line
    neutral: float = 0.0  # Value with which the robot behaves as declared
    kind: Literal["number", "rotor", "convention"] = "number"  # A number to fit, a rotor's number, or a kept number
    optional: bool = False  # Whether a robot file may leave it out, which then means ``neutral``


RotorTrait = Literal["reversible", "force", "slew", "dead_band"]  # One of `config.rotor.ROTOR_TRAITS`

ANY_ROTOR: tuple[RotorTrait, ...] = ("reversible", "force", "slew", "dead_band")
"""Rotor features of an effect whose law holds for every rotor."""

ActsOn = Literal["rotor", "actuation", "wrench", "inertia", "environment", "sensor"]


@dataclass(frozen=True, kw_only=True)
class SubstepStart:
    """State at the start of a substep, from which an effect updates its memory."""

    rotor_speed: Tensor  # Rotor speeds [rad/s], (E, R)
    since: Tensor  # Substeps since the environment was reset, int, (E,)
    random: Tensor  # Random states of this substep, for ``math.random.normal_draws``, (E,)
    dt: Tensor  # Length of the substep [s], ()
    vehicle: Vehicle  # Vehicle with the effects on its parameters applied
    shared: Tensor | None = None  # Random states that all vehicles of an environment share, (E,); None for ``random``

    def of_effect(self, effect: "Effect") -> "SubstepStart":
        """Return the start for one effect: the air of an environment moves alike for all of its vehicles."""
        shares = effect.acts_on == "environment" and self.shared is not None
        return replace(self, random=self.shared) if shares else self


class Effect(ABC):
    """A named physical effect.

    A direct subclass is a *hook*: one place in the step that calls a method of effects. A kind of effect implements one hook or
    several. The methods of a step are pure torch functions of rows; the fused kernel is traced from them, so they have no
    branches on values and no in-place writes. The class variables below describe it to the rest of the code, so no other module
    lists kinds. An effect of a step may keep M numbers of memory per environment. The backend stores them and passes them
    after the parameters, (E, P + M).
    """

    # Set by the kind of effect.
    acts_on: ClassVar[ActsOn]
    order: ClassVar[int | None] = None  # Rank of its numbers among the effects of a step; None outside the step
    single: ClassVar[str] = ""  # Name of what a vehicle has at most one of; empty if it may have several
    additive: ClassVar[bool] = False  # Whether it adds thrust, force or wind, which are zero at neutral parameters
    accelerates: ClassVar[bool] = False  # Whether the acceleration in a given state depends on its memory
    replayed: ClassVar[bool] = False  # Whether identification computes its memory along a flight by ``replay``
    needs_com: ClassVar[bool] = False  # Whether it depends on the centre of mass or on the sum of all forces
    moves_with_body: ClassVar[bool] = False  # Whether steppers integrate its memory. It has the highest `order`

    # Set by the effect itself.
    name: ClassVar[str]
    summary: ClassVar[str]
    parameters: tuple[Parameter, ...]  # By column P. An instance has its own if parts of a robot name them
    excitation: ClassVar[str]  # Quantities that must vary in a flight to make the effect visible
    confused_with: ClassVar[tuple[str, ...]]  # Effects with a similar signature, to be weighed against this one
    law_of: ClassVar[str] = ""  # Effect, named by its cause, of which it is another law; empty for the first law
    law: ClassVar[str] = "formula"  # Its law, in words
    in_place: ClassVar[bool] = False  # Whether selection fits it only in place of another law of its cause
    contains: ClassVar[tuple[str, ...]] = ()  # Special cases with as many parameters, preferred where flights fit both
    memory: ClassVar[tuple[float, ...]] = ()  # Values of its memory per environment right after a reset
    drifting: ClassVar[tuple[int, ...]] = ()  # Indices of remembered numbers that grow in a flight, such as charge
    rotor_memory: ClassVar[tuple[float, ...]] = ()  # Memory per rotor after a reset; all first numbers come first
    needs: ClassVar[tuple[Literal["position", "lin_vel", "ceiling_height", "other_position"], ...]] = ()
    """Quantities that a flight or the scene must provide."""
    needs_radius: ClassVar[bool] = False  # Whether it depends on the radius of the rotors
    follows: ClassVar[tuple[Literal["position", "velocity", "voltage"], ...]] = ()
    """Quantities that its force depends on: an imperfect law leaves a residual that follows them."""
    steady: ClassVar[bool] = (
        False  # Whether its size is the same at every position and time of a flight, as its law states
    )
    shown_by: ClassVar[tuple[str, ...]] = ()  # Parameters of which one must differ from neutral; empty: any of them
    told_by_torques: ClassVar[bool] = False  # Whether only torques distinguish it; without, it is no candidate
    shown_by_forces: ClassVar[bool] = False  # Whether forces alone show it although it acts on one rotor
    told_by_rotor_speeds: ClassVar[bool] = False  # Whether measured rotor speeds beside commands are needed for that
    logged: ClassVar[tuple[Literal["battery"], ...]] = ()  # Quantities that a log must hold in place of its memory
    rotors: ClassVar[tuple[RotorTrait, ...]] = ("slew", "dead_band")  # Allowed rotor features beyond a plain speed
    at_hubs: ClassVar[bool] = False
    """Whether rotors and their hubs alone cause it. A shift of the centre of mass then changes its torque only by the lever
    of its force. On a vehicle with joints it acts on the links that carry rotors, by their motion."""
    on_joints: ClassVar[bool] = True  # Whether a vehicle with joints can have it, on its base unless `at_hubs`
    on_rigid: ClassVar[bool] = True  # Whether a vehicle without joints, or one taken as rigid, can have it
    instead: ClassVar[tuple[str, ...]] = ()  # Effects to use in its place on a vehicle that cannot have it
    medium: ClassVar[Literal["air", "water"]] = "air"  # Fluid in which it matters; flights are in air
    random: ClassVar[bool] = False  # Whether it is random, so that it predicts no row of a flight
    by_default: ClassVar[bool] = True  # Whether selection considers it; False if others together look the same

    @property
    def cause(self) -> str:
        """Name of the cause, which all its laws share."""
        return self.law_of or self.name

    @property
    def is_candidate_of_selection(self) -> bool:
        """Whether selection can consider it: it predicts rows of a rigid vehicle in air."""
        return self.is_in_prediction and self.medium == "air"

    @property
    def is_in_prediction(self) -> bool:
        """Whether the prediction for a rigid vehicle includes it."""
        return self.on_rigid and not self.random

    @property
    def remembers(self) -> bool:
        """Whether it has memory of its own."""
        return bool(self.memory or self.rotor_memory)

    def fresh_memory(self, num_rotors: int) -> tuple[float, ...]:
        """Return the M numbers of memory of an environment right after a reset."""
        return self.memory + tuple(number for number in self.rotor_memory for _ in range(num_rotors))

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the memory (E, M) at the start of a substep, from parameters and memory (E, P + M).

        The forces of the substep use this memory as a constant: an operator splitting of first order.
        """
        return values[:, len(self.parameters) :]

    def replay(self, track: RotorSpeedsOfFlight, params: Tensor) -> Tensor:
        """Return the memory in every row of a measured flight, (T, M), from parameters (1, P).

        Identification needs it for a kind that is ``replayed`` and has memory.

        Raises:
            CapabilityError: If the effect has no replay.
        """
        raise CapabilityError(f"effect {self.name}: remembers, but cannot be followed along a flight: it has no replay")

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the parameters with which the robot behaves as declared."""
        return tuple(parameter.neutral for parameter in self.parameters)

    def starts(self, robot: RobotCfg) -> list[tuple[float, ...]]:
        """Return the initial parameters of fits: the neutral ones, for each rotor if it acts on one rotor."""
        neutral = self.neutral(robot)
        if self.parameters[0].kind != "rotor":
            return [neutral]
        return [(float(rotor), *neutral[1:]) for rotor in range(1, robot.num_rotors + 1)]

    def start_in_place(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the start of a fit in place of another law of its cause, from fitted ``in_first_law`` parameters by name."""
        return {parameter.name: values[parameter.name] for parameter in self.parameters if parameter.name in values}

    def in_first_law(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Return the parameters, by name, with which the first law of its cause acts most like this law."""
        return values

    def bounds(self, robot: RobotCfg) -> list[tuple[float, float]]:
        """Return the lowest and highest value of each parameter that is physically possible for a robot."""
        return [(parameter.low, parameter.high) for parameter in self.parameters]

    def bind_robot(self, robot: RobotCfg) -> "Effect":
        """Return the effect with the parameters of a robot file, which may be named after parts of the robot.

        Raises:
            ConfigError: If the robot has no such part.
        """
        return self

    def to_dtype(self, dtype: torch.dtype) -> "Effect":
        """Return the effect for another float type; itself if it holds no tensors."""
        return self

    def check(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` if the robot file lacks a number that the effect needs."""
        if self.needs_radius and any(rotor.radius is None for rotor in robot.rotor_types):
            raise ConfigError(f"effect {self.name}: the robot file must give rotor.radius [m], of every rotor type")

    def parse_params(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Return the parameters in order; raise ``ConfigError`` if one is unknown, missing or out of bounds."""
        known = [parameter.name for parameter in self.parameters]
        values = {one.name: one.neutral for one in self.parameters if one.optional} | dict(values)
        if set(values) != set(known):
            raise ConfigError(f"effect {self.name}: parameters {sorted(values)} given, needs exactly {known}")
        for parameter in self.parameters:
            value = values[parameter.name]
            if not parameter.low <= value <= parameter.high:
                raise ConfigError(
                    f"effect {self.name}.{parameter.name} = {value!r}: "
                    f"must lie in [{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
                )
        return tuple(float(values[name]) for name in known)
