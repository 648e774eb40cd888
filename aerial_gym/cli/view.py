"""``aerial-gym view``: a live or recorded flight in the browser."""

import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from aerial_gym.errors import ConfigError

if TYPE_CHECKING:
    from viser import ViserServer

    from aerial_gym.task import Task
    from aerial_gym.viewer.recording import RecordingPage
    from aerial_gym.viewer.simulation import FlightInView, Pilot

ROBOT, CONTROLLER, ENVIRONMENT = "base_quadrotor", "lee_position_control", "empty_env"
PILOTS = ("zero", "random")  # Words in place of a run folder


@dataclass(frozen=True, kw_only=True)
class ViewCmd:
    """Show a flight in the browser: a policy in its task, a controller whose goal you drag, or a recording (--log)."""

    task: str | None = None
    """Registered task, task file (.yaml), or module:Name; that of the policy, or a controller alone, if not given."""

    policy: str | None = None
    """Run folder or checkpoint of a training, pretrained/NAME, or zero or random; zero with --task alone."""

    env: str | None = None  # Registered environment, or an environment file; empty_env without a task
    robot: str | None = None  # Registered robot, or a robot file; base_quadrotor without a task
    controller: str | None = None  # Registered controller; lee_position_control without a task
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given

    effects: tuple[str, ...] | None = None
    """Effects to switch on in flight besides those of the robot file (aerial-gym list effects); common ones if not given."""

    log: tuple[str, ...] = ()  # Recorded flights of any log format; FILE#2 for one of several. --robot adds predictions
    corrected: str | None = None  # Corrected robot beside that of --robot: a robot file, or the folder of close-loop
    mapping: str | None = None  # Mapping of the logs' columns: a name or a file (.yaml)
    restart_s: float = 0.5  # Time between two restarts of the predictions from the measured state [s]
    num_envs: int = 1  # Environments side by side; the page chooses one, others are drawn faintly
    device: str = "cpu"  # Torch device; auto takes the GPU if there is one
    seed: int = 0  # Seed of the starts
    host: str = "127.0.0.1"  # Address of the page; any other than this one can be reached from other machines
    port: int = 8080  # Port of the page; 0 takes a free one
    open: bool = False  # Open the page in the browser of this machine

    def run(self) -> int:
        """Fly until Ctrl-C."""
        from aerial_gym.interop import one_thread
        from aerial_gym.viewer.server import close_server, open_server, page_url

        self._check_sources()
        server = open_server(self.host, self.port)
        try:
            with TemporaryDirectory() as folder, one_thread():
                from aerial_gym.viewer.live import LiveView

                view = self._open_recording(server) if self.log else LiveView(server, self._build_flight(folder))
                print(f"{page_url(server)}  (Ctrl-C ends)", file=sys.stderr, flush=True)
                if self.open:
                    import webbrowser

                    webbrowser.open(page_url(server))
                view.run()
        finally:
            close_server(server)
        return 0

    def _check_sources(self) -> None:
        """Raise ``ConfigError`` if options of a recording and of a simulation are mixed."""
        names = ("task", "policy", "env", "controller", "backend", "effects") if self.log else ("corrected", "mapping")
        if mixed := [f"--{name}" for name in names if getattr(self, name) is not None]:
            rule = (
                "--log shows a recorded flight; leave it out"
                if self.log
                else "belongs to a recorded flight; give --log"
            )
            raise ConfigError(f"{mixed[0]}: {rule}")
        if not 0.1 <= self.restart_s <= 10.0:
            raise ConfigError(f"--restart-s {self.restart_s:g}: must be from 0.1 to 10 s")

    def _open_recording(self, server: "ViserServer") -> "RecordingPage":
        from aerial_gym.cli.terminal import progress_bar
        from aerial_gym.viewer.flight_record import load_logs, load_vehicles
        from aerial_gym.viewer.recording import RecordingPage

        with progress_bar() as progress:
            progress("reading the logs", 0.0)
            robots = load_vehicles(self.robot, self.corrected)
            flights, notes = load_logs(self.log, robots, self.mapping)
            progress("predicting", 0.6)
            return RecordingPage(server, flights, robots, notes=notes, restart_s=self.restart_s)

    def _build_flight(self, folder: str) -> "FlightInView":
        from aerial_gym.viewer.simulation import FlightInView

        if self.task is None and self.policy is None:
            from aerial_gym.env_manager import SimBuilder

            env = SimBuilder().build_env(
                sim_name="base_sim", env_name=self.env or ENVIRONMENT, robot_name=self._robot_file(self.robot or ROBOT, folder),
                controller_name=self.controller or CONTROLLER, num_envs=self.num_envs, device=self.device,
                seed=self.seed, backend=self.backend,
            )  # fmt: skip
            return FlightInView(env)
        task, pilot = self._build_task(folder)
        return FlightInView(task.env, task, pilot)

    def _build_task(self, folder: str) -> "tuple[Task, Pilot]":
        from aerial_gym.config.changes import settings_of_run
        from aerial_gym.rl_training.policies.catalog import policy_path
        from aerial_gym.rl_training.policies.load import check_fits, load_policy
        from aerial_gym.task import task_registry
        from aerial_gym.viewer.simulation import constant_pilot, random_pilot

        policy = cfg = None
        if self.policy not in (None, *PILOTS):
            if not policy_path(self.policy).exists():
                raise ConfigError(f"--policy {self.policy}: no such run. Give a run folder, {' or '.join(PILOTS)}")
            policy, cfg = load_policy(self.policy, device=self.device)
        name = self.task or getattr(cfg, "task", "position_setpoint_task")
        robot = self.robot or getattr(cfg, "robot", None) or task_registry.get(name).robot
        task = task_registry.make_task(
            name, num_envs=self.num_envs, device=self.device, seed=self.seed, env=self.env,
            robot=self._robot_file(robot, folder), controller=self.controller or getattr(cfg, "controller", None),
            backend=self.backend, encoder=getattr(cfg, "encoder", None),
            settings=settings_of_run(getattr(cfg, "settings", ()), robot=self.robot, task=self.task),
        )  # fmt: skip
        task.require_one_vehicle("view")
        if policy is not None and cfg is not None:
            check_fits(policy, task, cfg.task)
            return task, policy
        return task, random_pilot(task, self.seed) if self.policy == "random" else constant_pilot(task)

    def _robot_file(self, name: str, folder: str) -> str:
        """Write and return a robot file with the effects that the page switches."""
        from aerial_gym.config import dump_yaml
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.viewer.effects import add_neutral_effects

        robot, file = add_neutral_effects(robot_by_name(name), self.effects), Path(folder) / "robot.yaml"
        file.write_text(dump_yaml(robot), encoding="utf-8", errors="surrogateescape")
        return str(file)
