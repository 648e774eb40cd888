"""Does every registered robot fly with every geometric controller at every sim? Errors, settling times, overshoots.

    python -m benchmarks.control_table [--json] [--out DIR]

One flight of 10 s for each: environment 0 starts at rest and is given a step, the others start as a reset draws them (seed 0)
and are told to rest. The step is 1 m, 1 m/s, 1 m/s² along x, 0.2 rad of roll, or 0.5 rad/s of yaw (of roll where the robot has
no yaw torque). Settled is within 2 % of the step for good; the error is the largest of the 16 others after 10 s, in the units
of the command, over what the law controls. Robots that differ only in their sensors fly once. Backend `warp` on the CPU; the
seed decides every number.
"""

import argparse
import json
from dataclasses import asdict, dataclass, replace
from math import pi
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots import ROBOTS

NUM_DRAWN = 16
SPAN = 10.0
SAMPLE = 0.02
"""Time between two looks at the state [s]."""

FAR_BELOW = -1000.0
"""Height of the ground [m]: a robot with ground effect flies as if there were none."""

SETTLED = 0.02
"""Share of the step."""

STEPS = {
    "position": 1.0,
    "pose": 1.0,
    "steering": 1.0,
    "velocity": 1.0,
    "acceleration": 1.0,
    "attitude": 0.2,
    "rates": 0.5,
}
UNITS = {
    "position": "m",
    "pose": "m",
    "steering": "m/s",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "attitude": "rad",
    "rates": "rad/s",
}


@dataclass(frozen=True)
class Flight:
    """What came of a robot under a controller at a sim."""

    robot: str
    controller: str
    law: str
    sim: str
    error: float
    """Largest of the drawn starts after 10 s, in ``UNITS``."""

    settling_s: float
    """Until the step stays within 2 %; infinite if it does not."""

    overshoot: float
    """Beyond the step, as a share of it."""

    tilt_rad: float
    """Largest angle between body z and world z in the last second."""

    response: tuple[float, ...]
    """To the step, as a share of it, at each sample."""


def different_robots() -> dict[str, RobotCfg]:
    """Return the registered rigid robots that fly differently, by the first name of each."""
    found: dict[str, RobotCfg] = {}
    for name in ROBOTS:
        robot = ROBOTS.get(name)
        flies = (robot.body, robot.rotor, robot.mounts, robot.control.buoyancy)
        if robot.joints is None and all(
            flies != (r.body, r.rotor, r.mounts, r.control.buoyancy) for r in found.values()
        ):
            found[name] = robot
    return found


def geometric_controllers() -> dict[str, ControllerCfg]:
    """Return the registered controllers whose law has gains that are the robot's own."""
    found = {name: CONTROLLERS.get(name) for name in CONTROLLERS}
    return {name: cfg for name, cfg in found.items() if cfg.law in STEPS and cfg.gains is None}


def unfit(robot: RobotCfg, controller: ControllerCfg) -> str:
    """Return why a controller does not fit a robot; empty if it does."""
    try:
        vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        make_controller(controller, vehicle, 9.81, dt=0.01, control=robot.control)
    except ConfigError as error:
        return str(error)
    return ""


def axes_of(robot: RobotCfg) -> tuple[bool, ...]:
    """Return about which body axes a robot can turn itself."""
    allocation = Allocation(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), 9.81)
    return tuple((allocation.torque_authority(robot.body.mass * 9.81) > 0.0).tolist())


def fly(robot: RobotCfg, controller: ControllerCfg, sim: SimCfg, *, names: tuple[str, str, str]) -> Flight:
    """Return one flight; ``names`` are those of robot, controller and sim."""
    law, can_turn = controller.law, axes_of(robot)
    env = EnvManager(
        sim=sim,
        env=replace(
            ENVIRONMENTS.get("empty_env"), physics_steps_per_env_step=round(SAMPLE / sim.dt), ground_height=FAR_BELOW
        ),
        robot=robot,
        controller=controller,
        num_envs=1 + NUM_DRAWN,
        device=torch.device("cpu"),
        seed=0,
    )
    env.reset()
    gtd = env.gtd
    for key in ("robot_position", "robot_linvel", "robot_body_angvel", "robot_orientation"):
        gtd[key][0] = 0.0
    gtd["robot_orientation"][0, 3] = 1.0
    actions = torch.zeros_like(gtd["robot_actions"])
    channel = {"attitude": 1, "rates": 3 if can_turn[2] else 1}.get(law, 0)
    actions[0, channel] = STEPS[law]
    before, response, errors, tilts = gtd["robot_linvel"].clone(), [], torch.zeros(0), []
    for _ in range(round(SPAN / SAMPLE)):
        env.step(actions)
        acceleration = (gtd["robot_linvel"] - before) / SAMPLE
        before = gtd["robot_linvel"].clone()
        measured = _measured(law, gtd, acceleration, can_turn)
        errors = measured[1:].norm(dim=-1)
        axis = channel - 1 if law in ("attitude", "rates") else 0
        response.append(float(_step_of(law, gtd, acceleration)[axis]) / STEPS[law])
        tilts.append(float(_tilt(gtd["robot_orientation"][1:]).max()))
    settled, overshoot = figures(response)
    return Flight(
        robot=names[0], controller=names[1], law=law, sim=names[2],
        error=float(errors.max()), settling_s=settled, overshoot=overshoot,
        tilt_rad=max(tilts[-round(1.0 / SAMPLE) :]), response=tuple(response),
    )  # fmt: skip


def _measured(law: str, gtd: GlobalTensorDictionary, acceleration: Tensor, can_turn: tuple[bool, ...]) -> Tensor:
    """Return what the law should have brought to zero."""
    return {
        "position": gtd["robot_position"],
        "pose": gtd["robot_position"],
        "steering": gtd["robot_linvel"],
        "velocity": gtd["robot_linvel"],
        "acceleration": acceleration,
        "attitude": gtd["robot_euler_angles"][:, :2],
        "rates": gtd["robot_body_angvel"] * torch.tensor(can_turn),
    }[law]


def _step_of(law: str, gtd: GlobalTensorDictionary, acceleration: Tensor) -> Tensor:
    """Return what answers to the step, (3,)."""
    rows = {
        "position": gtd["robot_position"],
        "pose": gtd["robot_position"],
        "steering": gtd["robot_vehicle_linvel"],
        "velocity": gtd["robot_vehicle_linvel"],
        "acceleration": acceleration,
        "attitude": gtd["robot_euler_angles"],
        "rates": gtd["robot_body_angvel"],
    }
    return rows[law][0]


def _tilt(attitude: Tensor) -> Tensor:
    return torch.acos((1.0 - 2.0 * (attitude[:, 0] ** 2 + attitude[:, 1] ** 2)).clamp(-1.0, 1.0))


def figures(response: list[float]) -> tuple[float, float]:
    """Return settling time [s] and overshoot of a response to a unit step, sampled from ``SAMPLE`` on."""
    outside = [i for i, value in enumerate(response) if abs(value - 1.0) > SETTLED]
    last = outside[-1] + 1 if outside else 0
    settling = (last + 1) * SAMPLE if last < len(response) else float("inf")
    return settling, max(max(response) - 1.0, 0.0)


def table(flights: list[Flight]) -> str:
    """Return the flights as a table, a row for each robot and law, the sims side by side."""
    sims = list(dict.fromkeys(flight.sim for flight in flights))
    lines = [
        "| robot | controller | " + " | ".join(f"`{sim}`: error, settling, overshoot" for sim in sims) + " |",
        "| --- | --- |" + " --- |" * len(sims),
    ]
    for robot, controller in dict.fromkeys((flight.robot, flight.controller) for flight in flights):
        cells = [_cell(f) for f in flights if (f.robot, f.controller) == (robot, controller)]
        lines.append(f"| `{robot}` | `{controller}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(flight: Flight) -> str:
    fell = " **fell**" if flight.tilt_rad > pi / 2 else ""
    return f"{flight.error:.2g} {UNITS[flight.law]}, {flight.settling_s:.3g} s, {flight.overshoot:.1%}{fell}"


def draw(flights: list[Flight], path: Path) -> None:
    """Draw the step responses at one sim, a panel for each law."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shape = {"figsize": (15, 8.5), "sharey": True, "sharex": "col", "layout": "constrained"}
    laws = ("position", "velocity", "acceleration", "attitude", "rates")
    figure, rows = pyplot.subplots(3, len(laws), **shape)
    robots = dict.fromkeys(flight.robot for flight in flights)
    colours = dict(zip(robots, pyplot.get_cmap("tab20").colors, strict=False))  # 20 of them
    for family, panels in zip(("lee", "pid", "px4"), rows, strict=True):
        for panel, law in zip(panels, laws, strict=True):
            name = f"{family}_{'rate' if (family, law) == ('px4', 'rates') else law}_control"
            for flight in flights:
                if flight.controller == name and flight.sim == "base_sim":
                    times = [SAMPLE * (i + 1) for i in range(len(flight.response))]
                    panel.plot(times, flight.response, label=flight.robot, lw=1.2, color=colours.get(flight.robot))
            panel.axhline(1.0, color="0.7", lw=0.8, zorder=0)
            panel.set(title=name, ylim=(-0.1, 1.4))
            panel.set_xlim(0.0, 8.0 if law in ("position", "velocity") else 3.0)
        panels[0].set_ylabel("share of the step")
    for panel in rows[-1]:
        panel.set_xlabel("t [s]")
    figure.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the table; with ``--out`` draw the steps too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one object a line instead of the table")
    parser.add_argument("--out", type=Path, help="folder for control_steps.png")
    options = parser.parse_args()
    flights = [
        fly(robot, controller, SIMS.get(sim), names=(name, controller_name, sim))
        for name, robot in different_robots().items()
        for controller_name, controller in geometric_controllers().items()
        if not unfit(robot, controller)
        for sim in SIMS
    ]
    if options.json:
        for flight in flights:
            print(json.dumps({key: value for key, value in asdict(flight).items() if key != "response"}))
    else:
        print(table(flights))
    if options.out is not None:
        draw(flights, options.out / "control_steps.png")


if __name__ == "__main__":
    main()
