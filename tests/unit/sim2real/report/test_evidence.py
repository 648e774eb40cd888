"""The line of a picture of evidence goes through its points, and says where one channel asks for something else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.gauss_newton import fit_effects
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.evidence import parameter_evidence, write_evidence
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor

SCALE, LIGHTER = 0.9, 0.8
EFFECT = "thrust_coefficient"


@pytest.mark.parametrize("lighter", [1.0, LIGHTER])
def test_the_line_is_that_of_all_points_and_each_channel_says_what_it_needs(lighter: float, tmp_path: Path) -> None:
    """Rotors give 0.9 of what is declared. Where the moments of inertia are declared 0.8 times too small as well, forces ask
    for 0.9 and turns for 0.72, no value makes both, and the fit lies between them."""
    body = replace(ROBOT.body, inertia=tuple(tuple(lighter * x for x in row) for row in ROBOT.body.inertia))
    robot = replace(ROBOT, body=body)
    tables = [flight(s, thrust_scale=SCALE, noise=0.1, seconds=6.0) for s in (1, 2)]
    flights = load_tables(tmp_path, tables, robot)
    train = make_predictor(flights, robot, channels=find_channels(flights)[:6])
    weight = inverse_variance_weights(train.residuals(ModelParams())).weight  # then all channels count about the same
    empty = [np.zeros((*measured.shape, 0)) for measured in train.measured]
    start = ModelParams(effects={EFFECT: np.ones(1)})
    beside = NuisanceSums(train.times, [[part] for part in empty], weight)
    params = fit_effects(train, (EFFECT,), start, beside)[0].params
    (clue,) = parameter_evidence(train, params, EFFECT, np.ones(1), weight)
    adds, beyond = (np.concatenate([getattr(c, name) for c in clue.clouds]) for name in ("adds", "beyond"))
    slope = (clue.fitted - clue.neutral) / clue.scale
    assert slope == pytest.approx(float(adds @ beyond / (adds @ adds)), abs=2e-3)
    alone = {cloud.channel.name: cloud for cloud in clue.clouds}
    for name, truth in (
        ("specific_force.z", SCALE),
        *((f"angular_acceleration.{axis}", SCALE * lighter) for axis in "xy"),
    ):
        assert alone[name].alone == pytest.approx(truth, abs=4.0 * alone[name].std)
        assert alone[name].std < 0.02
    assert clue.channels_to_plot[0].channel.name == max(alone, key=lambda name: alone[name].adds @ alone[name].adds)
    if lighter < 1.0:
        assert SCALE * lighter + 0.01 < clue.fitted < SCALE - 0.01
    assert parameter_evidence(train, params, EFFECT, np.ones(1), weight, untold=("scale",)) == []
    write_evidence(tmp_path / "evidence.csv", {EFFECT: [clue]})
    table = pd.read_csv(tmp_path / "evidence.csv").set_index("channel")
    assert 0.98 < table["share_told"].sum() <= 1.0 + 1e-4
    assert "specific_force.x" not in table.index  # thrust adds nothing there
    turned = "angular_acceleration.x"
    assert table.loc[turned, "alone"] == pytest.approx(alone[turned].alone, rel=1e-5)
