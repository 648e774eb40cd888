"""Closed-loop stability at hover: the eigenvalues of vehicles under a control law, and the hover error.

A loop is stable if its spectral radius over the controlled axes is below 1, linearised at its equilibrium
(``control.linear_loop``). Uncontrolled axes (position and heading under attitude control, say) are excluded; no controlled
axis depends on them at hover. The vehicle has the effects of its robot file that act in free air, and failures from the start
of an episode, but no random wind or forces. Joints stay in their reference pose.
Letters: B vehicles under one law, R rotors, X numbers of the state vector.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import exp, log

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.controllers import LeeController, make_controller
from aerial_gym.control.gains import apparent_gravity, gain_range
from aerial_gym.control.hover import (
    DISTURBANCE,
    HOVER_RANGE,
    HOVER_SPAN,
    HoverEquilibria,
    distances_from_start,
    find_equilibrium,
    hover_action,
    largest_final_distance,
    trim_axes,
)
from aerial_gym.control.linear_loop import AXES, BODY, DiscreteLoop
from aerial_gym.errors import ConfigError
from aerial_gym.physics.backend import ControlLaw
from aerial_gym.physics.effects import DelayEffect, EffectParams
from aerial_gym.physics.model import Model, build_model, check_effects, robot_effects
from aerial_gym.physics.vehicle import Vehicle, vehicle_from_config

TURNS, RATES = AXES[3:6], AXES[9:]

LOOP_GAINS = (0.5, 2.0)
"""Loop gains [-] at which a firm loop is stable too: a gain margin of 6 dB in both directions. Source: MIL-F-9490D (1975),
3.1.3.6.1, table III, and its successor SAE AS94900, for rigid-body modes."""

TIGHT_GAINS = (0.8, 1.25)  # Loop gains of a margin of 2 dB each way; with less, rotor limits may destabilise a loop
ROUND_OFF = 1e-7  # Tolerance of the spectral radius of a neutral mode around 1
DT_RANGE = (1e-5, 1.0)  # Search range of the largest stable time step [s]
HALVINGS = 24  # Bisections of the logarithm of that range: to 1e-6 of the time step
FINEST_DELAY = 24  # Most physics steps in a dead time for the search; finer ones change the lag by less than 5 %


Corner = tuple[int, ...] | None  # End of the range of each drawn gain, 0 or 1; None for the declared gains
HEIGHT = 2.0  # Height of the hover [m], world z, for wind by height
FAR = 1e3  # Distance of ground and ceiling from hover [m]


def hover_model(
    robot: RobotCfg, vehicle: Vehicle, *, gravity: float, effects: Sequence[EffectParams] | None = None
) -> Model:
    """Return the model of vehicles with given effects, or with those of a robot file that act at hover in free air."""
    if effects is None:
        check_effects(robot)
        effects = robot_effects(robot, num_envs=1, device=torch.device("cpu"), dtype=torch.float64, rigid=True)
    acting = [each for each in effects if not (each[0].random and each[0].additive)]
    return build_model(vehicle, acting, gravity=gravity, ground_height=-FAR, ceiling_height=FAR)


def largest_stable_dt(
    radius: Callable[[float], float], unstable: float, *, lowest: float = DT_RANGE[0]
) -> float | None:
    """Return the largest stable time step [s] below an unstable one; None if there is none.

    Args:
        radius: Spectral radius at a time step [s].
        unstable: A time step with a radius above 1.
        lowest: Shortest time step of the search.
    """
    low, high = lowest, unstable
    if low >= high or radius(low) > 1.0 + ROUND_OFF:
        return None
    for _ in range(HALVINGS):
        middle = exp(0.5 * (log(low) + log(high)))
        low, high = (middle, high) if radius(middle) <= 1.0 + ROUND_OFF else (low, middle)
    return low


def are_stable(radii: Sequence[float]) -> bool:
    """Return whether no spectral radius is above 1, up to round-off."""
    return max(radii) <= 1.0 + ROUND_OFF


@dataclass(frozen=True, kw_only=True)
class HoverResult:
    """Result of a hover that begins at its setpoint."""

    stable: bool  # Whether the loop has an equilibrium, and disturbances about it decay
    growth: float  # Factor on a small disturbance in each physics step: the spectral radius
    offset: tuple[float, float, float]  # Equilibrium relative to the setpoint [m], world; 0 without one
    drift: tuple[float, float, float]  # Velocity at equilibrium [m/s], world, of laws without position control

    distance: float
    """Largest predicted distance from the setpoint [m] within ``HOVER_SPAN`` of a start at rest there; that of the
    equilibrium for an unstable loop; 0 for laws without position or velocity control."""

    flown: float | None  # Distance from equilibrium [m] at the end of disturbed flights; None without flights

    @property
    def is_lost(self) -> bool:
        """Whether a disturbed vehicle does not return."""
        return not self.stable if self.flown is None else self.flown > HOVER_RANGE

    @property
    def is_within_range(self) -> bool:
        """Whether it stays within ``HOVER_RANGE``."""
        return not self.is_lost and self.distance <= HOVER_RANGE


class ClosedLoop:
    """The closed loop of a robot, or of several vehicles, under one controller at any time step."""

    def __init__(
        self, robot: RobotCfg, controller: ControllerCfg, *, gravity: float, integrator: str, names: tuple[str, str],
        drawn: Mapping[str, RandomizeCfg] | None = None, model: Model | None = None,
    ) -> None:  # fmt: skip
        """Find the hover thrusts and the controlled axes.

        Args:
            drawn: Ranges of drawn gains by name.
            model: Vehicles in float64 on the CPU, with equal dead time, in place of the robot with its effects.

        Raises:
            ConfigError: If the rotors cannot carry the declared vehicle, or an effect cannot act on it.
        """
        self._robot, self._controller, self._gravity, self._integrator = robot, controller, gravity, integrator
        self.drawn = drawn or {}
        """Ranges of drawn gains, by name."""
        self._corners = [None, *(product((0, 1), repeat=len(self.drawn)) if self.drawn else ())]
        self._vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        self._model = hover_model(robot, self._vehicle, gravity=gravity) if model is None else model
        places = self._model.effects.places(self._vehicle.num_rotors)
        self._drifting = [place.memory.start + number for place in places for number in place.effect.drifting]
        self.delay = max((float(effect.delay(p).max()) for effect, p in self._model.effects[DelayEffect]), default=0.0)
        """Longest dead time [s]."""
        self._rests: dict[tuple[float, Corner], HoverEquilibria] = {}
        self._modes: dict[tuple[float, Corner, float], Tensor] = {}
        allocation = Allocation(self._vehicle, gravity)
        self._felt = apparent_gravity(robot.control, robot.body.mass, gravity)
        weight = robot.body.mass * self._felt
        self._hover = allocation.inverse[0, :, 2] * weight
        low, high = allocation.low[0], allocation.high[0]
        if bool(((self._hover < low) | (self._hover > high)).any()):
            raise ConfigError(
                f"robot {names[0]} cannot hover under controller {names[1]}: its rotors need "
                f"{self._hover.tolist()} N, their limits are {low.tolist()} to {high.tolist()} N"
            )
        weak = allocation.torque_authority(weight) == 0.0
        turns = list(zip(TURNS, RATES, weak.tolist(), strict=True))
        idle = {name for turn, rate, none in turns if none for name in (turn, rate)}
        held = trim_axes(controller) or ()
        self.axes = " ".join(name for name in held if name not in idle)
        """Of ``AXES``, what the law and the rotors control."""
        self.idle = [name for name in TURNS if name in idle and name in held]
        """Of ``TURNS``, what the law holds and the rotors cannot."""

    def spectral_radius(self, dt: float) -> float:
        """Return the largest spectral radius of ``spectral_radii`` at a time step [s]."""
        return max(self.spectral_radii(dt))

    def spectral_radii(self, dt: float) -> list[float]:
        """Return the spectral radii with the declared gains and with each combination of ends of the drawn ones."""
        return [self._corner_radius(corner, 1.0, dt) for corner in self._corners]

    def spectral_radii_at_loop_gains(self, dt: float) -> list[float]:
        """Return the spectral radii with the declared gains at each of ``LOOP_GAINS``."""
        return [self._corner_radius(None, gain, dt) for gain in LOOP_GAINS]

    def is_stable(self, dt: float) -> bool:
        """Return whether the loop is stable at a time step [s], also at the ends of drawn gains."""
        at_rest = all(bool(self.equilibrium(dt, corner).converged.all()) for corner in self._corners)
        return at_rest and are_stable(self.spectral_radii(dt))

    def is_stable_with_margin(self, dt: float) -> bool:
        """Return whether the loop is stable at a time step [s] with the margin of ``LOOP_GAINS``."""
        return self.is_stable(dt) and are_stable(self.spectral_radii_at_loop_gains(dt))

    def largest_dt_with_margin(self, unfirm: float) -> float | None:
        """Return the largest time step [s] below an infirm one with the margin of ``LOOP_GAINS``; None if there is none."""
        cases = [*((corner, 1.0) for corner in self._corners), *((None, gain) for gain in LOOP_GAINS)]
        best: float | None = unfirm
        lowest = max(DT_RANGE[0], self.delay / FINEST_DELAY)
        while best is not None and not are_stable(radii := [self._corner_radius(*case, best) for case in cases]):
            best = largest_stable_dt(partial(self._corner_radius, *cases[radii.index(max(radii))]), best, lowest=lowest)
        return best

    def _corner_radius(self, corner: Corner, loop_gain: float, dt: float) -> float:
        return float(self._corner_modes(corner, loop_gain, dt).abs().max())

    def _corner_modes(self, corner: Corner, loop_gain: float, dt: float) -> Tensor:
        if (dt, corner, loop_gain) not in self._modes:
            self._modes[dt, corner, loop_gain] = self._eigenvalues(self.equilibrium(dt, corner), loop_gain)
        return self._modes[dt, corner, loop_gain]

    def _eigenvalues(self, rest: HoverEquilibria, loop_gain: float) -> Tensor:
        mapped, width = rest.loop.period_map(gain=loop_gain), rest.state.shape[1]
        rows = [*self._indices_of_controlled_states(width), *range(width, mapped.shape[1] - 1)]
        return torch.linalg.eigvals(mapped[:, rows][:, :, rows]) ** (1.0 / len(rest.loop.steps))

    def spectral_radius_of_each_vehicle(self, dt: float) -> Tensor:
        """Return the spectral radius of each vehicle at a time step [s], (B,)."""
        return self._corner_modes(None, 1.0, dt).abs().amax(-1)

    def hover(self, dt: float) -> HoverResult:
        """Return the hover of the first vehicle at a time step [s], with flights if rotor limits may matter."""
        result = self.hover_of_each_vehicle(dt)[0]
        tight = not (result.stable and are_stable([self._corner_radius(None, gain, dt) for gain in TIGHT_GAINS]))
        if not self.holds_place or not (tight or self._reaches_slew_limit(dt)):
            return result
        loop, returns = self._make_loop(dt, None), "x" in self.axes.split()
        flown = largest_final_distance(
            loop, self.equilibrium(dt), self._action(dt), returns=returns, decays=result.stable
        )
        return replace(result, flown=flown)

    def _reaches_slew_limit(self, dt: float) -> bool:
        """Return whether a disturbance exceeds the rotors' slew rate, by the change of the command over the lag."""
        vehicle, size = self._model.vehicle, torch.tensor(DISTURBANCE, dtype=torch.float64).repeat_interleave(3)
        if "slew" not in vehicle.traits:
            return False
        change = self.equilibrium(dt).loop.steps[0].command[0, :, :BODY].abs() @ size
        slowest = (vehicle.time_constant_up * vehicle.slew_rate).minimum(
            vehicle.time_constant_down * vehicle.slew_rate_down
        )
        return bool((change > slowest[0]).any())

    def hover_of_each_vehicle(self, dt: float) -> list[HoverResult]:
        """Return the hover of each vehicle at a time step [s], without flights."""
        rest, growth = self.equilibrium(dt), self.spectral_radius_of_each_vehicle(dt)
        rests, way = rest.converged & (growth <= 1.0 + ROUND_OFF), torch.zeros_like(growth)
        if self.holds_place:
            away = rest.offset_from_start.norm(dim=-1) + HOVER_SPAN * rest.drift_velocity.norm(dim=-1)
            way = torch.where(rests, self.largest_distance_of_each_vehicle(dt), away)
        rows = (rests, growth, rest.offset_from_start, rest.drift_velocity, way)
        return [
            HoverResult(
                stable=stays, growth=factor, offset=tuple(offset), drift=tuple(drift), distance=distance, flown=None
            )
            for stays, factor, offset, drift, distance in zip(*(row.tolist() for row in rows), strict=True)
        ]

    @property
    def holds_place(self) -> bool:
        """Whether the law controls position, or velocity, which is 0 at hover."""
        return "vx" in self.axes.split()

    def equilibrium(self, dt: float, corner: Corner = None) -> HoverEquilibria:
        """Return the equilibrium of the loop at a time step [s]."""
        if (dt, corner) not in self._rests:
            loop = self._make_loop(dt, corner)
            start = loop.start(HEIGHT, self._hover)
            self._rests[dt, corner] = find_equilibrium(
                loop, start, self._action(dt), self._indices_of_controlled_states(start.shape[1])
            )
        return self._rests[dt, corner]

    def deviation_bound(self, dt: float, steps: int, size: Tensor) -> Tensor:
        """Return bounds of the deviations on ``AXES``, (12,), after some steps from deviations up to a size on each axis."""
        loop = self.equilibrium(dt).loop
        mapped = torch.linalg.matrix_power(loop.period_map()[0], steps // len(loop.steps))
        return mapped[:BODY, :BODY].abs() @ size.to(mapped)

    def largest_distance_of_each_vehicle(self, dt: float) -> Tensor:
        """Return the largest distance [m] of each vehicle from its start within ``HOVER_SPAN`` of hover, (B,)."""
        rest = self.equilibrium(dt)
        return distances_from_start(rest, rotors=rest.start[0, BODY : BODY + len(self._hover)], dt=dt).amax(0)

    def _indices_of_controlled_states(self, width: int) -> list[int]:
        """Return the indices of controlled states in a state vector of the given width."""
        first = BODY + len(self._hover)
        drifting = {first + place for place in self._drifting}
        return [AXES.index(name) for name in self.axes.split()] + [
            number for number in range(BODY, width) if number not in drifting
        ]

    def _action(self, dt: float) -> Tensor:
        law = make_controller(self._controller, self._vehicle, self._gravity, dt=dt, control=self._robot.control)
        return hover_action(law, HEIGHT)

    def _make_loop(self, dt: float, corner: Corner) -> DiscreteLoop:
        return DiscreteLoop(
            self._model, partial(self._make_law, dt, corner), declared=self._vehicle, dt=dt, integrator=self._integrator
        )

    def _make_law(self, dt: float, corner: Corner, vehicle: Vehicle) -> ControlLaw:
        law = make_controller(self._controller, vehicle, self._gravity, dt=dt, control=self._robot.control)
        if corner is None:
            return law
        from aerial_gym.control.cascade import CascadeController

        if isinstance(law, LeeController | CascadeController):
            chosen, known = zip(self.drawn.items(), corner, strict=True), law.gains_by_name
            ends = {name: gain_range(name, cfg, known[name])[end] for (name, cfg), end in chosen if name in known}
            law.gains = replace(law.gains, **ends)
        return law
