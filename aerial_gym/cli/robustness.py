"""``aerial-gym robustness``: the conditions in which a policy fails, worst first, with advice for each."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.cli.evaluate import PolicyOptions
from aerial_gym.cli.terminal import print_table, progress_bar

if TYPE_CHECKING:
    from aerial_gym.rl_training.robustness.result import CellResult, Robustness


@dataclass(frozen=True, kw_only=True)
class RobustnessCmd(PolicyOptions):
    """Measure success and tracking of a policy in named conditions: rates, delays, noise, losses and physical effects."""

    ranges: Path | None = None  # Robot file of close-loop --ranges: its intervals become conditions
    quick: bool = False  # Fewer conditions with 48 flights each
    flights: int | None = None  # Flights in each condition, >= 1; 1000 if not given, 48 with --quick
    out: Path | None = None  # Folder for robustness.json, written after every simulation, and robustness.png
    json: bool = False  # Print one JSON object

    def run(self) -> int:
        """Fly and print the conditions; return the exit status."""
        result = self.result()
        if self.json:
            print(json.dumps(asdict(result)))
            return 0
        head = ("condition", "success", "95 % interval", "crashed", "final error", "result")
        print_table((_row(each) for each in (*result.cells, result.clean)), head)
        for text in (each.advice for each in result.cells if each.advice):
            print(f"- {text}")
        left_out = "; ".join(f"{name} ({reason})" for name, reason in result.not_flown.items())
        print(f"Effects that were not flown: {left_out or 'none'}")
        return 0

    def result(self) -> "Robustness":
        """Return the figures of all conditions."""
        from aerial_gym.config.storage import write_atomic
        from aerial_gym.errors import ConfigError
        from aerial_gym.interop import one_thread
        from aerial_gym.rl_training.robustness.figure import write_figure
        from aerial_gym.rl_training.robustness.plan import make_plan
        from aerial_gym.rl_training.robustness.sweep import fly_cells

        flights = (48 if self.quick else 1000) if self.flights is None else self.flights
        if flights < 1:
            raise ConfigError(f"flights = {flights}: must be >= 1")
        policy, trained_on, flown = self.load()
        plan = make_plan(flown, quick=self.quick, ranges=self.ranges)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        with progress_bar() as progress, one_thread():
            for result in fly_cells(policy, flown, plan, flights=flights, trained_on=trained_on, on_progress=progress):
                if self.out is not None:
                    write_atomic(self.out / "robustness.json", json.dumps(asdict(result), indent=1))
        if self.out is not None:
            write_figure(result, self.out / "robustness.png")
        return result


def _row(each: "CellResult") -> tuple[str, ...]:
    error = "" if each.error_mean_m is None else f"{each.error_mean_m:.3g} m"
    interval = f"{each.success_low:.1%} to {each.success_high:.1%}"
    return (each.label, f"{each.success_rate:.1%}", interval, f"{each.crash_rate:.1%}", error, each.outcome)
