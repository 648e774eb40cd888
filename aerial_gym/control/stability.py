"""Whether a vehicle under a control law comes to rest: the closed loop as it is sampled, linearised at hover.

One step of the torch reference, in float64, with the real allocation and rotor lag, is differentiated by central differences,
all perturbations side by side as environments. With rates and memory it is a whole period, memory is perturbed too, and the
derivative is the product of those of its steps, of which all of one phase are alike: hover is at rest in each. The
vehicle comes to rest if the spectral radius over the axes that the law controls is below 1; what it leaves to itself (position
and heading under attitude control, say) is left out, as none of the controlled axes depends on it at hover. That must hold with
a gain margin: near the limit a loop is lost as soon as a rotor is at one of its own.
Letters: N axes with rotors, R rotors.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from math import exp, log

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.cascade import CascadeController
from aerial_gym.control.controllers import LeeController, make_controller
from aerial_gym.control.gains import GAINS, apparent_gravity, ends_of, explicit_gains_of, has_explicit_gains
from aerial_gym.control.laws import LAWS
from aerial_gym.control.remembering import RememberingController
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp, quat_log
from aerial_gym.physics.backend import ControlLaw
from aerial_gym.physics.integrators import INTEGRATORS, Stepper, to_body_state, to_mass_state
from aerial_gym.physics.law_memory import law_command
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle, share_row, vehicle_from_config

AXES = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "p", "q", "r")
"""Motion about hover [m, rad, m/s, rad/s]."""

TURNS, RATES = AXES[3:6], AXES[9:]

LOOP_GAINS = (0.5, 2.0)
"""Factors on what a law asks of the rotors beyond hover [-] with which the loop must come to rest too: a gain margin of 6 dB
either way. Source: MIL-F-9490D (1975), 3.1.3.6.1, table III, and SAE AS94900 after it, for modes of the rigid body."""

NUDGE = 1e-5
"""Size of the differences, in the units of the axes: their error is its square."""

ROUND_OFF = 1e-7
"""By which the spectral radius of a mode that neither grows nor decays may miss 1."""

DT_RANGE = (1e-5, 1.0)
"""Time steps [s] between which the largest stable one is looked for."""

HALVINGS = 24
"""Of the logarithm of that range: to 1e-6 of the time step."""


def single_vehicle(vehicle: Vehicle, num_rows: int) -> Vehicle:
    """Return the first environment's vehicle in ``num_rows`` rows on the CPU, in float64."""
    return vehicle.map_rows(lambda rows: share_row(rows[0].detach().cpu().double(), num_rows))


def closed_loop_modes(
    vehicle: Vehicle,
    make_law: Callable[[Vehicle], ControlLaw],
    hover_action: Tensor,
    *,
    axes: str,
    gravity: float,
    dt: float,
    integrator: str,
    hover_thrust: Tensor,
    loop_gain: float = 1.0,
) -> Tensor:
    """Return the eigenvalues of the closed loop at hover, complex, by physics step: ``exp(s dt)`` of its poles s.

    A law with memory is followed over its own period, together with what it remembers; they are the roots of those.

    Args:
        vehicle: As declared.
        make_law: Returns the law for a vehicle of any number of rows.
        hover_action: That holds the vehicle at rest at the origin, (U,).
        axes: Names among ``AXES`` that the law controls; the rotors always count.
        gravity: Downward acceleration of free fall [m/s²].
        dt: Time step [s].
        integrator: Name of the stepper.
        hover_thrust: Thrusts at rest [N], (R,).
        loop_gain: Factor on what the law asks of the rotors beyond hover [-].
    """
    law = make_law(single_vehicle(vehicle, 1))
    memory = law.resting(hover_thrust) if isinstance(law, RememberingController) else None
    extra = 0 if memory is None else memory.shape[0]
    width, steps = len(AXES) + vehicle.num_rotors + extra, law.period if isinstance(law, RememberingController) else 1
    plant = single_vehicle(vehicle, 2 * width)
    trim = _speed(plant, hover_thrust)
    rest = trim if memory is None else torch.cat((trim, memory.to(trim)))
    size = torch.cat((torch.ones(len(AXES), dtype=trim.dtype), rest.abs().clamp_min(1.0)))
    nudges = NUDGE * torch.cat((torch.eye(width, dtype=trim.dtype), -torch.eye(width, dtype=trim.dtype)))
    loop = _Loop(make_law(plant), build_model(plant, gravity=gravity), INTEGRATORS[integrator], dt, loop_gain)
    action, slopes = hover_action.to(trim).expand(2 * width, -1), {}
    slope = torch.eye(width, dtype=trim.dtype)
    for step in range(steps):
        phase = law.phase(step) if isinstance(law, RememberingController) else None
        if phase not in slopes:
            end = loop.after(nudges * size, rest, action, step) / size
            slopes[phase] = (end[:width] - end[width:]).T / (2.0 * NUDGE)
        slope = slopes[phase] @ slope
    if isinstance(law, RememberingController):
        slope = torch.cat((slope[: width - extra], law.turned_back(slope[width - extra :].T).T))
    kept = [AXES.index(name) for name in axes.split()] + list(range(len(AXES), width))
    return torch.linalg.eigvals(slope[kept][:, kept]) ** (1.0 / steps)


class _Loop:
    """A step of a closed loop, from offsets to offsets (2 N, N) from rest."""

    def __init__(self, law: ControlLaw, model: Model, stepper: Stepper, dt: float, gain: float) -> None:
        self._law, self._model, self._stepper, self._dt, self._gain = law, model, stepper, dt, gain

    def after(self, offsets: Tensor, rest: Tensor, action: Tensor, step: int) -> Tensor:
        """Return where the offsets are after a step of the period; ``rest`` is that of rotors and memory."""
        num_rotors = self._model.vehicle.num_rotors
        state = _state(offsets[:, : len(AXES) + num_rotors], rest[:num_rotors])
        cascade = self._law if isinstance(self._law, RememberingController) else None
        resting, changes = rest[num_rotors:], offsets[:, len(AXES) + num_rotors :]
        memory = None if cascade is None else cascade.memory_from(resting + changes, step)
        command, memory = law_command(self._law, state, action, memory)
        command = rest[:num_rotors] + self._gain * (command - rest[:num_rotors])
        state = to_body_state(
            self._model, self._stepper(self._model, to_mass_state(self._model, state), command, self._dt)
        )
        moved = _offsets(state, rest[:num_rotors])
        if cascade is None or memory is None:
            return moved
        return torch.cat((moved, cascade.remembered(memory) - resting), dim=-1)


def _speed(plant: Vehicle, thrust: Tensor) -> Tensor:
    return state_for_thrust(plant, thrust.to(plant.mass).expand(plant.num_envs, -1))[0]


def _state(offsets: Tensor, trim: Tensor) -> BodyState:
    position, turn, lin_vel, ang_vel, rotors = offsets.split((3, 3, 3, 3, trim.shape[0]), dim=-1)
    return BodyState(
        position=position, attitude=quat_exp(turn), lin_vel=lin_vel, ang_vel=ang_vel, rotor_speed=trim + rotors
    )


def _offsets(state: BodyState, trim: Tensor) -> Tensor:
    parts = replace(state, attitude=quat_log(state.attitude), rotor_speed=state.rotor_speed - trim)
    return torch.cat(parts.tensors(), dim=-1)


def largest_stable_dt(radius: Callable[[float], float], unstable: float) -> float | None:
    """Return the largest time step [s] below an unstable one at which the loop is stable; None if there is none.

    Args:
        radius: Spectral radius at a time step [s].
        unstable: A time step at which it is above 1.
    """
    low, high = DT_RANGE[0], unstable
    if radius(low) > 1.0 + ROUND_OFF:
        return None
    for _ in range(HALVINGS):
        middle = exp(0.5 * (log(low) + log(high)))
        low, high = (middle, high) if radius(middle) <= 1.0 + ROUND_OFF else (low, middle)
    return low


def check_closed_loop(
    robot: RobotCfg,
    controller: ControllerCfg,
    *,
    gravity: float,
    dt: float,
    integrator: str,
    names: tuple[str, str],
    randomize: Randomize | None = None,
) -> None:
    """Refuse a robot that under its controller at this time step does not come to rest, or has too little gain margin.

    The margin is that of ``LOOP_GAINS``. So it is with derived gains, with those of a robot file, and with those that the name
    of a controller means. Someone's result may be worth reproducing as it is, limit cycles and all: with
    ``ControllerCfg.if_unstable`` there is a warning instead.

    Args:
        robot: What flies, as declared.
        controller: Law and gains.
        gravity: Downward acceleration of free fall [m/s²].
        dt: Time step [s].
        integrator: Name of the stepper.
        names: Of robot and controller, for people.
        randomize: What is drawn, by name; the ends of its gains must come to rest as well.

    Raises:
        ConfigError: If the vehicle cannot hover, or the loop is refused.
    """
    if controller.law not in LAWS:
        return
    loop = ClosedLoop(
        robot, controller, gravity=gravity, integrator=integrator, names=names, drawn=drawn_gains(randomize or {})
    )
    if vain := _held_in_vain(loop.idle, controller, robot):
        refuse(
            controller,
            f"robot {names[0]} with controller {names[1]}: the explicit gains hold {vain}, about which its rotors have no "
            f"torque, and an error that stays there hides the others. Give attitude gains of 0 about {vain}, or leave them out",
        )
    if loop.is_firm(dt):
        return
    radii, margins = loop.radii(dt), loop.margins(dt)
    if not _rests(radii):
        fault = f"is unstable: a disturbance at hover grows by a factor of {max(radii):.3g} in each step"
    else:
        gain, growth = max(zip(LOOP_GAINS, margins, strict=True), key=lambda pair: pair[1])
        fault = f"is nearly unstable: asking {gain:g} times as much of the rotors, a disturbance grows by {growth:.3g} a step"
    gains, way_out = _gains_at_fault(loop, controller, robot, drawn=_rests(radii[:1]) and not _rests(radii))
    best = loop.largest_firm_dt(dt)
    span = (
        "No dt has a gain margin of 6 dB"
        if best is None
        else f"The largest dt with a gain margin of 6 dB is {best:.3g} s"
    )
    refuse(
        controller,
        f"robot {names[0]} with controller {names[1]} at dt = {dt:g} s {fault}, with {gains}. {span}: {way_out}",
    )


def refuse(controller: ControllerCfg, message: str) -> None:
    """Raise ``ConfigError`` with a message, or warn where ``ControllerCfg.if_unstable`` says so."""
    if controller.if_unstable == "refuse":
        raise ConfigError(message)
    logging.getLogger(__name__).warning(message)


def _held_in_vain(idle: list[str], controller: ControllerCfg, robot: RobotCfg) -> str:
    """Return about which axes explicit gains would hold a vehicle whose rotors cannot; empty if there are none."""
    explicit = None if controller.autopilot else explicit_gains_of(controller, robot.control)
    return "" if explicit is None else " and ".join(name for name in idle if explicit.attitude[TURNS.index(name)] > 0.0)


def _rests(radii: list[float]) -> bool:
    return max(radii) <= 1.0 + ROUND_OFF


def _gains_at_fault(loop: "ClosedLoop", controller: ControllerCfg, robot: RobotCfg, *, drawn: bool) -> tuple[str, str]:
    """Return which gains do not hold a vehicle, and what can be done."""
    if drawn:
        names = ", ".join(f"gains.{name}" for name in loop.drawn)
        return f"gains at the ends of what is drawn of {names}", "narrow these ranges (randomize:)"
    if not has_explicit_gains(controller, robot.control):
        return "its frequencies and damping", "lower the frequencies"
    return (
        "the explicit gains given",
        "lower them, or leave them out to have them derived (lee_*, pid_*); "
        'dataclasses.replace(controller, if_unstable="warn") flies them as they are',
    )


def drawn_gains(randomize: Randomize) -> dict[str, RandomizeCfg]:
    """Return what is drawn of gains, by their own names."""
    return {name: randomize[f"gains.{name}"] for name in GAINS if f"gains.{name}" in randomize}


class ClosedLoop:
    """A robot under a controller, at any time step."""

    def __init__(
        self,
        robot: RobotCfg,
        controller: ControllerCfg,
        *,
        gravity: float,
        integrator: str,
        names: tuple[str, str],
        drawn: Mapping[str, RandomizeCfg] | None = None,
    ) -> None:
        """Find hover, and the axes that the law and the rotors control."""
        self._robot, self._controller, self._gravity, self._integrator = robot, controller, gravity, integrator
        self.drawn = drawn or {}
        """What is drawn of gains, by name."""
        self._corners = [None, *(product((0, 1), repeat=len(self.drawn)) if self.drawn else ())]
        self._vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        allocation = Allocation(self._vehicle, gravity)
        self._felt = apparent_gravity(robot.control, robot.body.mass, gravity)
        weight = robot.body.mass * self._felt
        self._hover = allocation.inverse[0, :, 2] * weight
        low, high = allocation.low[0], allocation.high[0]
        if bool(((self._hover < low) | (self._hover > high)).any()):
            raise ConfigError(
                f"robot {names[0]} cannot hover under controller {names[1]}: its rotors must give "
                f"{self._hover.tolist()} N, their limits are {low.tolist()} to {high.tolist()} N"
            )
        weak = allocation.torque_authority(weight) == 0.0
        turns = list(zip(TURNS, RATES, weak.tolist(), strict=True))
        idle = {name for turn, rate, none in turns if none for name in (turn, rate)}
        held = LAWS[controller.law].trim.split()
        self.axes = " ".join(name for name in held if name not in idle)
        """Of ``AXES``, what the law and the rotors control."""
        self.idle = [name for name in TURNS if name in idle and name in held]
        """Of ``TURNS``, what the law holds and the rotors cannot."""

    def radius(self, dt: float) -> float:
        """Return the spectral radius at a time step [s]; where gains are drawn, the largest of ``radii``."""
        return max(self.radii(dt))

    def radii(self, dt: float) -> list[float]:
        """Return the spectral radius with the declared gains, then with each combination of ends of the drawn ones."""
        return [self._radius_with(corner, 1.0, dt) for corner in self._corners]

    def margins(self, dt: float) -> list[float]:
        """Return the spectral radius with the declared gains times each of ``LOOP_GAINS``."""
        return [self._radius_with(None, gain, dt) for gain in LOOP_GAINS]

    def is_firm(self, dt: float) -> bool:
        """Return whether a time step [s] is not refused: the loop comes to rest, also with the margin of ``LOOP_GAINS``."""
        return _rests(self.radii(dt) + self.margins(dt))

    def largest_stable_dt(self, unstable: float) -> float | None:
        """Return the largest time step [s] below an unstable one at which all are stable; None if there is none."""
        return self._largest_dt([(corner, 1.0) for corner in self._corners], unstable)

    def largest_firm_dt(self, unfirm: float) -> float | None:
        """Return the same with the margin of ``LOOP_GAINS``: the largest time step [s] that is not refused."""
        return self._largest_dt(
            [*((corner, 1.0) for corner in self._corners), *((None, gain) for gain in LOOP_GAINS)], unfirm
        )

    def _largest_dt(self, cases: list[tuple[tuple[int, ...] | None, float]], unstable: float) -> float | None:
        best: float | None = unstable
        while best is not None and not _rests(radii := [self._radius_with(*case, best) for case in cases]):
            best = largest_stable_dt(partial(self._radius_with, *cases[radii.index(max(radii))]), best)
        return best

    def modes(self, dt: float) -> Tensor:
        """Return ``exp(s dt)`` of the poles s [1/s] of the loop with the declared gains at a time step [s], complex."""
        return self._modes_with(None, 1.0, dt)

    def _radius_with(self, corner: tuple[int, ...] | None, loop_gain: float, dt: float) -> float:
        return float(self._modes_with(corner, loop_gain, dt).abs().max())

    def _modes_with(self, corner: tuple[int, ...] | None, loop_gain: float, dt: float) -> Tensor:
        def make_law(vehicle: Vehicle) -> ControlLaw:
            law = make_controller(self._controller, vehicle, self._gravity, dt=dt, control=self._robot.control)
            if corner is not None and isinstance(law, LeeController | CascadeController):
                chosen, known = zip(self.drawn.items(), corner, strict=True), law.named_gains
                ends = {name: ends_of(name, cfg, known[name])[end] for (name, cfg), end in chosen if name in known}
                law.gains = replace(law.gains, **ends)
            return law

        return closed_loop_modes(
            self._vehicle,
            make_law,
            torch.zeros(len(LAWS[self._controller.law].action)),
            axes=self.axes,
            gravity=self._felt,
            dt=dt,
            integrator=self._integrator,
            hover_thrust=self._hover,
            loop_gain=loop_gain,
        )
