"""Recorded setpoints of five sets of public logs, flown by the law of their firmware in the vehicle of the log."""

from pathlib import Path

import pytest

from aerial_gym.robots.drafts.draft import robot_yaml_with_origins
from aerial_gym.sim2real import replay
from aerial_gym.sim2real.teststand.vehicle_from_log import draft_vehicle

DATA = Path(__file__).parents[2].parent / "shared" / "data"
LOGS = {
    "px4_ulog/sample_px4_events.ulg": ("controller_flown", {"rates", "attitude", "position"}, 2.0, None),
    "px4_ulog/battery_brownout.ulg": ("controller_flown", {"rates", "attitude", "position"}, 2.0, None),
    "real_logs/px4/quad_hover_second_output_instance.ulg": (
        "controller_flown", {"rates", "attitude", "position"}, 1.5, None,
    ),
    "real_logs/betaflight/bf451_erpm_5inch.BFL": ("controller_flown", {"rates"}, 0.6, 0.11),
    "real_logs/betaflight/indiflight_LOG00278.BFL": (
        "controller_stands_in", {"rates", "attitude", "position"}, 0.428, 0.07,
    ),
    "real_logs/ardupilot/copter364_two_flights.bin#1": ("controller_stands_in", {"rates", "attitude"}, 1.5, 0.25),
}  # fmt: skip
"""Finding, levels of setpoints, assumed mass [kg] and arm [m] of each set."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}"),
]


@pytest.mark.parametrize("log", LOGS)
def test_recorded_setpoints_fly_in_the_vehicle_of_the_log(log: str, tmp_path: Path) -> None:
    """Mass and arm are assumed. The firmware's own position control stays near the flight for two seconds; others drift."""
    code, levels, mass, arm = LOGS[log]
    draft = draft_vehicle([DATA / log], mass=mass, arm=arm)
    (tmp_path / "v.yaml").write_text(robot_yaml_with_origins(draft, name=log))
    (tmp_path / "v.mapping.yaml").write_text(draft.mapping)
    mapping = str(tmp_path / "v.mapping.yaml") if draft.mapping else None
    trip = replay(str(tmp_path / "v.yaml"), [DATA / log], mapping=mapping, setpoints=True).round_trip
    assert trip is not None
    assert code in {finding.code for finding in trip.findings}
    assert {level.level for level in trip.levels} <= levels
    for level in trip.levels:
        table = {quantity: level.rms("declared", quantity) for quantity in level.errors["declared"]}
        shown = {name: {h: f"{rms.value:.3g}" for h, rms in values.items()} for name, values in table.items()}
        print(log, level.level, level.valid.sum(axis=0).tolist(), shown)
        assert table["attitude"][0.5].value < 1.0
        if level.level == "position" and code == "controller_flown":
            assert table["position"][2.0].value < 1.5
        if "px4_events" in log and level.level == "attitude":  # PX4 itself, in its own simulator
            assert table["attitude"][2.0].value < 0.02
