"""The loop on a Crazyflie 2.1 of which duty cycles and battery voltage are known (NanoBench, arXiv 2603.09908)."""

import json
from pathlib import Path

import pytest

from aerial_gym.sim2real import close_loop

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "nanobench_cf21"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}"),
]


def test_drag_and_thrust_are_named_and_hold_on_other_shapes(tmp_path: Path) -> None:
    """Trained on circle, eight, oval, star and lissajous; measured -86, -61 and -97 % on trefoil and helix, held to 80 %."""
    train = ("B2_circle_fast_rep1", "B3_figure8_fast_rep1", "B7_oval_fast_rep1", "B8_star_medium_rep1")
    test = ("B9_trefoil_fast_rep1", "B5_helix_fast_rep1")
    logs = [[DATA / f"{name}.csv" for name in names] for names in (train, test)]
    out = tmp_path / "out"
    close_loop("crazyflie_21", *logs, out, mapping="nanobench_cf21", bandwidth=4.0)
    verdict = json.loads((out / "verdict.json").read_text())
    named = {effect["name"]: effect["params"] for effect in verdict["effects"]}
    assert {"rotor_drag", "h_force_flapping"} & set(named)
    assert {"thrust_coefficient", "payload_mass"} & set(verdict["candidates"])
    before, after = (verdict[when]["specific_force"] for when in ("before", "after"))
    for axis, fall in (("x", 0.86), ("y", 0.61), ("z", 0.97)):
        assert after[axis]["rms"] < (1.0 - 0.8 * fall) * before[axis]["rms"]
    for horizon in ("0.1", "0.5", "1", "2"):
        error = [verdict[when]["rollout_given_attitude"][horizon]["position"]["rms"] for when in ("before", "after")]
        assert error[1] < 0.25 * error[0]
