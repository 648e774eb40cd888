"""Flights of every registered robot under every geometric controller that fits it.

    python -m benchmarks.control.control_table [--write docs/results/control.md] [--out docs/images]

Robots that differ only in their sensors fly once, with every controller that takes the robot's own gains, and with those whose
name stands for the gains of a robot, at every sim (``control_flights``). Controllers of the second kind also fly other robots,
at `base_sim`. Robots with joints fly there with their own gains. ``--out`` draws the step responses at `base_sim`.
"""

import platform
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import pi
from pathlib import Path
from statistics import median

import torch
import tyro
import warp

from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import (
    MEANT_FOR,
    SAMPLE,
    SPAN,
    STEPS,
    UNITS,
    ControlFlight,
    fly_robot,
    geometric_controllers,
    holds_shape,
    misfit_reason,
    robot_controllers,
    robots_by_dynamics,
    target_robot,
)
from benchmarks.markdown import insert_between_marks, table

BEGIN, END = "<!-- tables: begin, by python -m benchmarks.control.control_table -->", "<!-- tables: end -->"

LOST = 10.0  # Error after 10 s in steps, from which on a vehicle is called lost
NEGLIGIBLE = 1e-3  # Error in `UNITS` below which no figure is given

HELD = ("position", "pose", "velocity", "steering")
"""Laws of position and velocity: their error in wind remains unless they have an integral."""

COMPARED_SIMS = tuple(sim for sim in SIMS if sim != "base_sim_headless")  # All but the second name of base_sim
COARSEST = "base_sim"  # The sim with the longest time step


@dataclass(frozen=True)
class Refusal:
    """A controller that does not fit a robot at a sim."""

    robot: str
    controller: str
    sim: str
    refused: str  # What the message says

    @property
    def of_kind(self) -> bool:
        """Whether the law does not fit the vehicle with any gains; else the gains are unsuitable at this time step."""
        return self.refused.startswith("law ")


def fly_all(
    robots: Iterable[str], controllers: Iterable[str], sims: Iterable[str] = COMPARED_SIMS
) -> tuple[list[ControlFlight], list[Refusal]]:
    """Return the flights and the refusals of all named robots, controllers and sims."""
    flights, refusals, named = [], [], robot_controllers()
    for robot in robots:
        cfg = ROBOTS.get(robot)
        for controller in controllers:
            foreign = controller in named and target_robot(controller) != robot
            for sim in sims:
                why = misfit_reason(cfg, CONTROLLERS.get(controller), SIMS.get(sim), names=(robot, controller))
                if why:
                    refusals.append(Refusal(robot, controller, sim, why))
                elif not foreign or (sim == COARSEST and _holds_place(controller)):
                    law = CONTROLLERS.get(controller)
                    flights.append(fly_robot(cfg, law, SIMS.get(sim), names=(robot, controller, sim)))
    return flights, refusals


def _holds_place(controller: str) -> bool:
    return CONTROLLERS.get(controller).law in ("position", "pose")


def flights_with_own_gains(flights: list[ControlFlight]) -> list[ControlFlight]:
    """Return the flights with the robot's own gains: derived, from its file, or of a controller named for it."""
    named = robot_controllers()
    return [f for f in flights if f.controller not in named or target_robot(f.controller) == f.robot]


def _error_text(error: float) -> str:
    return f"< {NEGLIGIBLE:g}" if error < NEGLIGIBLE else f"{error:.2g}"


def _step_text(settling: float, overshoot: float) -> str:
    if not overshoot < LOST:
        return "**lost**"
    return f"{f'{settling:.3g}' if settling < SPAN else f'> {SPAN:g}'}, {overshoot:.0%}"


def _controller_names(flights: list[ControlFlight]) -> list[str]:
    """Return the controllers of flights, each once."""
    return list(dict.fromkeys(flight.controller for flight in flights))


def _controller_flights(flights: list[ControlFlight], controller: str, sim: str = COARSEST) -> list[ControlFlight]:
    """Return the flights of a controller at a sim."""
    return [flight for flight in flights if (flight.controller, flight.sim) == (controller, sim)]


def _largest_error_text(flights: list[ControlFlight], error: Callable[[ControlFlight], float]) -> str:
    """Return the largest error with its unit, and its robot if it is not negligible."""
    worst = max(flights, key=error)
    text = f"{_error_text(error(worst))} {UNITS[worst.law]}"
    return text if error(worst) < NEGLIGIBLE else f"{text} (`{worst.robot}`)"


def _is_lost(flight: ControlFlight) -> bool:
    """Return whether a vehicle is lost after its rotors were at their limits."""
    return not flight.limit_error <= LOST * STEPS[flight.law]


def controllers_table(flights: list[ControlFlight]) -> str:
    """Return a row for each controller: the largest error from drawn starts at the coarsest sim, and steps at each sim."""
    flights, lines = flights_with_own_gains(flights), []
    heads = [f"step, {1e3 * SIMS.get(sim).dt:g} ms" for sim in COMPARED_SIMS]
    for controller in _controller_names(flights):
        rows = _controller_flights(flights, controller)
        error = _largest_error_text(rows, lambda flight: flight.error) if rows else "-"
        cells = [_controller_summary(_controller_flights(flights, controller, sim)) for sim in COMPARED_SIMS]
        lines.append((f"`{controller}`", len(rows), error, *cells))
    return table(("controller", "robots", "largest error from drawn starts, 10 ms", *heads), lines)


def _controller_summary(flights: list[ControlFlight]) -> str:
    """Return the median settling time, the largest overshoot, and the number of vehicles lost with rotors at limits."""
    if not flights:
        return "-"
    answer = _step_text(median(f.settling_s for f in flights), max(f.overshoot for f in flights))
    lost = sum(map(_is_lost, flights))
    return f"{answer}, {lost} lost" if lost else answer


def steps_table(flights: list[ControlFlight], refusals: list[Refusal], controllers: Iterable[str]) -> str:
    """Return a row for each robot: a step of 1 m and the error from drawn starts under each controller of position."""
    controllers = [name for name in controllers if _holds_place(name)]
    cells: dict[tuple[str, str], str] = {}
    for flight in (f for f in flights if f.sim == COARSEST):
        answer = f"{_step_text(flight.settling_s, flight.overshoot)}, {_error_text(flight.error)}"
        lost = flight in flights_with_own_gains([flight]) and _is_lost(flight)
        cells[flight.robot, flight.controller] = f"{answer}, **lost**" if lost else answer
    for refusal in (r for r in refusals if r.sim == COARSEST):
        cells[refusal.robot, refusal.controller] = "unfit" if refusal.of_kind else "refused"
    robots = dict.fromkeys(row.robot for row in (*flights, *refusals))
    lines = ((f"`{robot}`", *(cells.get((robot, name), "-") for name in controllers)) for robot in robots)
    return table(("robot", *(f"`{name}`" for name in controllers)), lines)


def wind_table(flights: list[ControlFlight]) -> str:
    """Return a row for each controller of position or velocity: its error in wind, and the share that remains after 10 s."""
    lines = []
    held = [f for f in flights_with_own_gains(flights) if f.sim == COARSEST and f.law in HELD and f.wind_largest > 0.0]
    for controller in _controller_names(held):
        rows = _controller_flights(held, controller)
        middle = f"{_error_text(median(f.wind_error for f in rows))} {UNITS[rows[0].law]}"
        share = median(f.wind_error / f.wind_largest for f in rows)
        largest = _largest_error_text(rows, lambda flight: flight.wind_error)
        lines.append((f"`{controller}`", len(rows), middle, largest, f"{share:.0%}"))
    remaining = "share of the largest error that remains, median"
    return table(("controller", "robots", "error after 10 s, median", "largest", remaining), lines)


def refusals_table(refusals: list[Refusal]) -> str:
    """Return the robots that each controller refuses at the coarsest sim, for its law and for its gains."""
    alike: dict[tuple[str, ...], list[str]] = {}
    for controller in dict.fromkeys(r.controller for r in refusals):
        rows = [r for r in refusals if r.controller == controller and r.sim == COARSEST]
        cells = tuple(_name_list(r.robot for r in rows if r.of_kind == of_kind) for of_kind in (True, False))
        alike.setdefault(cells, []).append(controller)
    heads = ("controllers", "vehicles that do not fit the law", "vehicles that the gains do not stabilise")
    return table(heads, ((_name_list(controllers), *cells) for cells, controllers in alike.items()))


def _name_list(robots: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in dict.fromkeys(robots)) or "-"


def joints_table(flights: list[ControlFlight]) -> str:
    """Return a row for each robot with joints: how many controllers lose it at the coarsest sim."""
    lines = []
    for robot in dict.fromkeys(flight.robot for flight in flights):
        rows = [flight for flight in flights if flight.robot == robot]
        overturned = sum(flight.tilt_rad > pi / 2 for flight in rows)
        lost = sum(not flight.overshoot < LOST for flight in rows)
        error = next((_error_text(f.error) for f in rows if f.controller == "lee_position_control"), "-")
        lines.append((f"`{robot}`", len(rows), overturned, lost, sum(map(_is_lost, rows)), error))
    heads = ("robot", "controllers", "overturned from drawn starts", "lost after a step", "lost with rotors at limits")
    return table((*heads, "error from drawn starts under `lee_position_control` [m]"), lines)


def control_page(
    flights: list[ControlFlight], refusals: list[Refusal], joints: tuple[list[ControlFlight], list[Refusal]]
) -> str:
    """Return the tables with hardware and versions; ``joints`` are the flights and refusals of robots with joints."""
    meant = ", ".join(f"`{family}_*` from `{robot}`" for family, robot in MEANT_FOR.items())
    versions = f"torch {torch.__version__.split('+')[0]}, Warp {warp.config.version}"
    return "\n\n".join(
        (
            "## How good is each controller?",
            "Steps: median settling time [s], largest overshoot, and the number of vehicles lost with rotors at limits.",
            controllers_table(flights),
            f"{len(flights) + len(joints[0])} flights in all tables; {platform.machine()} CPU, Python "
            f"{platform.python_version()}, {versions}.",
            "## How does each robot answer a step of 1 m?",
            "Own gains, 100 Hz: settling time [s], overshoot, error from drawn starts [m]. **lost**: with rotors at limits; "
            "unfit: the law does not fit the vehicle.",
            steps_table(flights, refusals, geometric_controllers()),
            "## How large is the error in wind?",
            wind_table(flights),
            "## Gains of another robot",
            f"These controllers take the gains of one robot: {meant}. Cells are as above. Other robots are not judged "
            "with rotors at limits.",
            steps_table(flights, refusals, robot_controllers()),
            "## Refused by name",
            refusals_table(refusals),
            "## Robots with joints",
            joints_table(joints[0]),
        )
    )


def draw_steps(flights: list[ControlFlight], path: Path) -> None:
    """Draw the step responses at the coarsest sim, a panel for each controller, those of the named gains by law."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    flights = [f for f in flights_with_own_gains(flights) if f.sim == COARSEST]
    named = set(robot_controllers())
    panels: dict[str, Callable[[ControlFlight], bool]] = {
        name: lambda f, name=name: f.controller == name for name in geometric_controllers()
    }
    panels |= {
        f"{'|'.join(family for family in MEANT_FOR if family != 'rov')}_{law}_control": lambda f, law=law: (
            f.controller in named and f.law == law
        )
        for law in ("position", "velocity", "acceleration", "attitude", "rates")
    }
    panels["rov_fully_actuated_control"] = lambda f: f.controller == "rov_fully_actuated_control"
    columns = 6
    shape = {"figsize": (16, 13), "sharey": True, "layout": "constrained"}
    figure, axes = pyplot.subplots(-(-len(panels) // columns), columns, **shape)
    names = dict.fromkeys(flight.robot for flight in flights)
    ramp = pyplot.get_cmap("nipy_spectral")
    colours = {name: ramp((i + 0.5) / len(names)) for i, name in enumerate(names)}
    lines = {}
    for (title, shown), panel in zip(panels.items(), axes.flat, strict=False):
        slow = False
        for flight in (f for f in flights if shown(f)):
            times = [SAMPLE * (i + 1) for i in range(len(flight.response))]
            (lines[flight.robot],) = panel.plot(times, flight.response, lw=1.1, color=colours[flight.robot])
            slow = slow or flight.law in ("position", "pose", "velocity", "steering")
        panel.axhline(1.0, color="0.7", lw=0.8, zorder=0)
        panel.set(ylim=(-0.1, 1.4), xlim=(0.0, 8.0 if slow else 3.0))
        panel.set_title(title, fontsize=8)
    for panel in axes.flat[len(panels) :]:
        panel.set_axis_off()
    for panel in axes[:, 0]:
        panel.set_ylabel("share of the step")
    for panel in axes[-1]:
        panel.set_xlabel("t [s]")
    figure.legend(lines.values(), lines, loc="outside lower center", ncols=6, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


@dataclass(frozen=True, kw_only=True)
class ControlTableCmd:
    """Fly robots under controllers, and print the tables."""

    write: Path | None = None  # Page with the marks
    out: Path | None = None  # Folder for control_steps.png

    def run(self) -> None:
        """Print the tables; write them between the marks of a page, and draw the steps, as asked."""
        if self.write is not None and not self.write.is_file():
            sys.exit(f"--write {self.write}: no such page")
        torch.set_num_threads(1)
        flights, refusals = fly_all(robots_by_dynamics(), (*geometric_controllers(), *robot_controllers()))
        bending = [name for name in robots_by_dynamics(bend=True) if holds_shape(ROBOTS.get(name))]
        text = control_page(flights, refusals, fly_all(bending, geometric_controllers(), [COARSEST]))
        if self.write is None:
            print(text)
        else:
            insert_between_marks(self.write, BEGIN, END, text)
        if self.out is not None:
            draw_steps(flights, self.out / "control_steps.png")


if __name__ == "__main__":
    tyro.cli(ControlTableCmd, description=__doc__).run()
