"""Evaluations, setups and verdicts of which a test states only the parts that matter."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.stages import LoopSetup
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.outcome import Outcome
from aerial_gym.sim2real.judge.random_wind.gusts import RandomWind
from aerial_gym.sim2real.judge.residual_excess import ResidualExcess
from aerial_gym.sim2real.judge.verdict import NamedEffect, Verdict
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.statistics import Rise, Rms
from tests.unit.sim2real.flat_flights import ROBOT, PredictorStub

FORCES = tuple(Channel(kind="specific_force", axis=axis) for axis in "xyz")


def make_evaluation(*rms: float, channels: tuple[Channel, ...] = FORCES, floor: float | None = None) -> ModelEvaluation:
    """Return an evaluation with these errors of the channels, with intervals of 10 % and an equal floor of all."""
    return ModelEvaluation(
        channels=channels,
        residual=tuple(Rms(value=value, low=0.9 * value, high=1.1 * value) for value in rms),
        floor=None if floor is None else (floor,) * len(channels),
        rollouts={},
        rollout={},
    )


def make_outcome(quantity: str, value: float, low: float, high: float, horizon: float | None = None) -> Outcome:
    """Return a rise with its interval; 5 % is material."""
    return Outcome(quantity=quantity, horizon=horizon, rise=Rise(value=value, low=low, high=high), least=0.05)


def make_named_effect(name: str = "com_offset", **more: Any) -> NamedEffect:
    """Return a named effect; by default an offset of the centre of mass by 4 mm."""
    numbers = {"params": {"x": 0.004, "y": 0.0}, "std": {"x": 1e-4, "y": 1e-4}, "noise_std": {}, "frozen": ()}
    return NamedEffect(name=name, **{"confidence": 0.99} | numbers | more)


def make_verdict(kind: str = "none", **more: Any) -> Verdict:
    """Return a verdict without effects, outcomes or open points but for those that are given."""
    empty = dict.fromkeys(("open_points", "effects", "candidates", "outcomes", "unexplained"), ())
    empty |= {name: {} for name in ("not_testable", "fly_next", "inclusion", "sets", "flights")}
    models = {"before": make_evaluation(1, 1, 1), "after": make_evaluation(1, 1, 1)}
    return Verdict(verdict=kind, **empty | {"manoeuvre": None, "structure": Structure()} | models | more)


def make_setup(
    train: Sequence[Flight] = (), robot: RobotCfg = ROBOT, *, channels: Sequence[Channel] = FORCES, band: float = 10.0
) -> LoopSetup:
    """Return a setup with training flights alone, for which a band of 10 Hz was requested."""
    return LoopSetup(
        stated=robot, robot=robot, params=ModelParams(), train=PredictorStub(robot=robot, flights=train),
        test=PredictorStub(robot=robot, channels=channels, bandwidth=band), asked_bandwidth=10.0,
    )  # fmt: skip


def make_excess(deviation: np.ndarray | None = None, **more: Any) -> ResidualExcess:
    """Return a residual in which nothing stays open but what is given."""
    empty = {"left": [], "floor": None, "wind": RandomWind(), "structure": Structure()}
    empty |= dict.fromkeys(("channels", "left_open", "of_flights", "open_to"), ())
    return ResidualExcess(within=ModelParams(deviation=deviation), **empty | more)
