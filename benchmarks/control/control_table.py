"""Does every registered robot fly with every geometric controller that fits it? Errors, settling times, overshoots.

    python -m benchmarks.control.control_table [--json] [--write docs/results/control.md] [--out docs/images]

Robots that differ only in their sensors fly once, with every controller whose gains are the robot's own, and with those whose
name means its gains, at every sim (``control_flights``). Gains that a name means fly other robots too, at `base_sim`. Robots
that bend fly there with the gains that they have of their own. What is refused is listed. ``--json`` prints all of it, an
object a line; ``--out`` draws the steps at `base_sim`.
"""

import argparse
import json
import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from math import isfinite, isnan, pi
from pathlib import Path
from statistics import median

import torch
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
    Flight,
    different_robots,
    fly,
    geometric_controllers,
    holds_shape,
    meant_for,
    named_controllers,
    unfit,
)

BEGIN, END = "<!-- tables: begin, by python -m benchmarks.control.control_table -->", "<!-- tables: end -->"

LOST = 10.0
"""Error after 10 s in steps, from which on a vehicle is called lost."""

HELD = ("position", "pose", "velocity", "steering")
"""Laws whose error in wind stays unless they have an integral of position or velocity: with one it falls, quickly or slowly."""

COMPARED_SIMS = tuple(sim for sim in SIMS if sim != "base_sim_headless")
"""All but the second name of base_sim."""

COARSEST = "base_sim"
"""The sim with the longest time step."""


@dataclass(frozen=True)
class Refusal:
    """A controller that does not fit a robot at a sim."""

    robot: str
    controller: str
    sim: str
    refused: str  # What the message says

    @property
    def of_kind(self) -> bool:
        """Whether the law does not fit the vehicle, whatever the gains; else the gains do not hold it at this time step."""
        return self.refused.startswith("law ")


def fly_all(
    robots: Iterable[str], controllers: Iterable[str], sims: Iterable[str] = COMPARED_SIMS
) -> tuple[list[Flight], list[Refusal]]:
    """Return the flights of robots under controllers at sims, by their names, and what was refused."""
    flights, refusals, named = [], [], named_controllers()
    for robot in robots:
        cfg = ROBOTS.get(robot)
        for controller in controllers:
            foreign = controller in named and meant_for(controller) != robot
            for sim in sims:
                why = unfit(cfg, CONTROLLERS.get(controller), SIMS.get(sim), names=(robot, controller))
                if why:
                    refusals.append(Refusal(robot, controller, sim, why))
                elif not foreign or (sim == COARSEST and _holds_place(controller)):
                    law = CONTROLLERS.get(controller)
                    flights.append(fly(cfg, law, SIMS.get(sim), names=(robot, controller, sim)))
    return flights, refusals


def _holds_place(controller: str) -> bool:
    return CONTROLLERS.get(controller).law in ("position", "pose")


def own(flights: list[Flight]) -> list[Flight]:
    """Return the flights with a robot's own gains, derived, of its file, or meant by the name."""
    named = named_controllers()
    return [f for f in flights if f.controller not in named or meant_for(f.controller) == f.robot]


def table(flights: list[Flight]) -> str:
    """Return a row for each robot and controller at the coarsest sim."""
    lines = [
        "| robot | controller | error | settling, overshoot | in wind: error at rest, largest | "
        "rotors at limits: share, settling, overshoot, error |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for flight in (f for f in own(flights) if f.sim == COARSEST):
        unit = UNITS[flight.law]
        fell = "" if flight.tilt_rad <= pi / 2 else " **fell**"
        lost = "" if flight.limit_error <= LOST * STEPS[flight.law] else " **lost**"
        wind = "-" if isnan(flight.wind_error) else f"{_held(flight.wind_error)}, {_held(flight.wind_largest)} {unit}"
        lines.append(
            f"| `{flight.robot}` | `{flight.controller}` | {_held(flight.error)} {unit}{fell} | "
            f"{_answer(flight.settling_s, flight.overshoot)} | {wind} | {flight.limit_share:.0%}, "
            f"{_answer(flight.limit_settling_s, flight.limit_overshoot)}, {_held(flight.limit_error)} {unit}{lost} |"
        )
    return "\n".join(lines)


def _finite(value: str | float) -> str | float | None:
    """Return a value as JSON can have it: null for what is infinite or not measured."""
    return value if isinstance(value, str) or isfinite(value) else None


def _held(error: float) -> str:
    return "< 0.001" if error < 1e-3 else f"{error:.2g}"


def _answer(settling: float, overshoot: float) -> str:
    if not overshoot < LOST:
        return "**lost**"
    return f"{f'{settling:.3g} s' if settling < SPAN else f'> {SPAN:g} s'}, {overshoot:.0%}"


def sims_table(flights: list[Flight]) -> str:
    """Return a row for each controller, the sims side by side, over its robots."""
    lines = [
        "| controller | " + " | ".join(f"`{sim}` ({1e3 * SIMS.get(sim).dt:g} ms)" for sim in COMPARED_SIMS) + " |",
        "| --- |" + " --- |" * len(COMPARED_SIMS),
    ]
    for controller in dict.fromkeys(f.controller for f in own(flights)):
        cells = [
            _over([f for f in own(flights) if (f.controller, f.sim) == (controller, sim)]) for sim in COMPARED_SIMS
        ]
        lines.append(f"| `{controller}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _over(flights: list[Flight]) -> str:
    """Return what came of one controller at one sim: robots, median settling, largest overshoot, how many are lost."""
    if not flights:
        return "-"
    settling = median(f.settling_s for f in flights)
    lost = sum(not f.limit_error <= LOST * STEPS[f.law] for f in flights)
    return f"{len(flights)}: {_answer(settling, max(f.overshoot for f in flights))}" + (
        f", {lost} lost" if lost else ""
    )


def wind_table(flights: list[Flight]) -> str:
    """Return a row for each controller that holds a place or a velocity: which share of the largest error in wind is left."""
    lines = [
        "| controller | robots | left after 10 s of the largest error, median | least |",
        "| --- | --- | --- | --- |",
    ]
    held = [f for f in own(flights) if f.sim == COARSEST and f.law in HELD and f.wind_largest > 0.0]
    for controller in dict.fromkeys(f.controller for f in held):
        left = {f.robot: f.wind_error / f.wind_largest for f in held if f.controller == controller}
        least, middle = min(left, key=left.__getitem__), median(left.values())
        lines.append(f"| `{controller}` | {len(left)} | {middle:.0%} | {left[least]:.0%} (`{least}`) |")
    return "\n".join(lines)


def refusals_table(refusals: list[Refusal]) -> str:
    """Return which robots each controller refuses, for their kind and for its gains at each sim; a row for those alike."""
    sims = sorted(COMPARED_SIMS, key=lambda sim: -SIMS.get(sim).dt)
    heads = ["not a vehicle for the law", *(f"its gains do not hold at {1e3 * SIMS.get(sim).dt:g} ms" for sim in sims)]
    lines = [f"| controller | {' | '.join(heads)} |", "| --- |" + " --- |" * len(heads)]
    alike: dict[tuple[str, ...], list[str]] = {}
    for controller in dict.fromkeys(r.controller for r in refusals):
        mine = [r for r in refusals if r.controller == controller]
        cells = [_names(r.robot for r in mine if r.of_kind)]
        cells += [_names(r.robot for r in mine if not r.of_kind and r.sim == sim) for sim in sims]
        alike.setdefault(tuple(cells), []).append(controller)
    lines += [f"| {_names(controllers)} | {' | '.join(cells)} |" for cells, controllers in alike.items()]
    return "\n".join(lines)


def _names(robots: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in dict.fromkeys(robots)) or "-"


def foreign_table(flights: list[Flight], refusals: list[Refusal]) -> str:
    """Return a row for each robot: what becomes of a step of a metre with the gains of each robot that a name means."""
    controllers = [name for name in named_controllers() if _holds_place(name)]
    found: dict[tuple[str, str], str] = {}
    for flight in (f for f in flights if f.sim == COARSEST and f.controller in controllers):
        answer = _answer(flight.settling_s, flight.overshoot)
        found[flight.robot, flight.controller] = f"{answer}, {_held(flight.error)} m"
    for refusal in (r for r in refusals if r.sim == COARSEST):
        found[refusal.robot, refusal.controller] = "not for it" if refusal.of_kind else "refused"
    lines = [f"| robot | {' | '.join(f'`{name}`' for name in controllers)} |", "| --- |" + " --- |" * len(controllers)]
    for robot in dict.fromkeys(f.robot for f in flights):
        lines.append(f"| `{robot}` | {' | '.join(found.get((robot, name), '-') for name in controllers)} |")
    return "\n".join(lines)


def bent_tables(flights: list[Flight], refusals: list[Refusal]) -> str:
    """Return the rows of robots that bend, who refuses them, and which robots do not fly here and why."""
    robots = {name: ROBOTS.get(name) for name in ROBOTS}
    bend = {name: robot for name, robot in robots.items() if robot.joints is not None}
    stand = _names(name for name, robot in bend.items() if robot.joints is not None and not robot.joints.floating)
    limp = _names(name for name, robot in bend.items() if not holds_shape(robot))
    refused = dict.fromkeys(r.controller for r in refusals)
    rows = [f"- `{name}`: {_names(r.robot for r in refusals if r.controller == name)}" for name in refused]
    return "\n\n".join(
        (
            "Joints move; the controllers take the vehicle as rigid in its reference pose. Drives are told that pose, and the "
            "tail of `tilt_tricopter` what holds the heading.",
            table(flights),
            f"Not flown: {stand}, whose base is on a stand; {limp}, whose drives follow rates or efforts, so that it takes a "
            "law for the joints to hold a shape, which is no controller's ([joints](../joints.md#snakes-that-hold-and-fold)).",
            "\n".join(("Refused at 100 Hz:\n", *rows)) if rows else "None is refused.",
        )
    )


def page(flights: list[Flight], refusals: list[Refusal], bent: tuple[list[Flight], list[Refusal]]) -> str:
    """Return all tables and what they were made with; ``bent`` are the flights and refusals of robots that bend."""
    made = (
        f"{len(flights) + len(bent[0])} flights; {platform.machine()} CPU, Python {platform.python_version()}, "
        f"torch {torch.__version__.split('+')[0]}, Warp {warp.config.version}."
    )
    meant = ", ".join(f"`{family}_*` of `{robot}`" for family, robot in MEANT_FOR.items())
    return "\n\n".join(
        (
            made,
            "### At 100 Hz",
            table(flights),
            "### At other time steps",
            "Robots, the median of their settling times, their largest overshoot, and how many are lost with rotors at limits.",
            sims_table(flights),
            "### In wind at 100 Hz",
            wind_table(flights),
            "### Refused by name",
            refusals_table(refusals),
            "### Gains that a name means, on other vehicles",
            f"A step of a metre at 100 Hz: settling, overshoot; and the error from drawn starts. Names mean gains: {meant}.",
            foreign_table(flights, refusals),
            "### Robots that bend, at 100 Hz",
            bent_tables(*bent),
        )
    )


def draw(flights: list[Flight], path: Path) -> None:
    """Draw the step responses at the coarsest sim, a panel for each controller, those of the named gains by law."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    flights = [f for f in own(flights) if f.sim == COARSEST]
    named = set(named_controllers())
    panels: dict[str, Callable[[Flight], bool]] = {
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


def _chosen(names: list[str] | None, robots: Iterable[str]) -> list[str]:
    return [name for name in robots if names is None or name in names]


def main() -> None:
    """Print the tables; with ``--write`` put them between the marks of a page, with ``--out`` draw the steps too."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one object a line instead of the tables")
    parser.add_argument("--write", type=Path, help="page with the marks")
    parser.add_argument("--out", type=Path, help="folder for control_steps.png")
    parser.add_argument("--robots", nargs="+", help="only these")
    parser.add_argument("--controllers", nargs="+", help="only these")
    options = parser.parse_args()
    if options.write is not None and not options.write.is_file():
        parser.error(f"--write {options.write}: no such page")
    torch.set_num_threads(1)
    controllers = options.controllers or [*geometric_controllers(), *named_controllers()]
    rigid, bending = (_chosen(options.robots, different_robots(bend=bend)) for bend in (False, True))
    flights, refusals = fly_all(rigid, controllers)
    own_gains = [name for name in controllers if name in geometric_controllers()]
    bent = fly_all([name for name in bending if holds_shape(ROBOTS.get(name))], own_gains, [COARSEST])
    text = page(flights, refusals, bent)
    if options.json:
        for row in (*flights, *refusals, *bent[0], *bent[1]):
            print(json.dumps({key: _finite(value) for key, value in asdict(row).items() if key != "response"}))
    elif options.write is None:
        print(text)
    if options.write is not None:
        before, _, rest = options.write.read_text(encoding="utf-8").partition(BEGIN)
        _, _, after = rest.partition(END)
        options.write.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")
    if options.out is not None:
        draw(flights, options.out / "control_steps.png")


if __name__ == "__main__":
    main()
