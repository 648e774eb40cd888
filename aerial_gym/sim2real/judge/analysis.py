"""Everything that a closed loop found, as a report shows it."""

from dataclasses import dataclass

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.identify.selection.select import Selection
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.predictor import Channel, ModelParams, Predictor


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """Everything that a report shows."""

    robot: RobotCfg
    corrected: RobotCfg
    train: tuple[Flight, ...]
    test: tuple[Flight, ...]
    channels: tuple[Channel, ...]
    bandwidth: float
    selection: Selection
    declared: ModelParams
    final: ModelParams
    train_predictor: Predictor
    test_predictor: Predictor
    verdict: Verdict
