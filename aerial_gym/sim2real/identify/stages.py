"""The first stages of the loop: the comparison of a robot with its flights, and the selection of effects."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.model import check_effects
from aerial_gym.sim2real.identify.battery import robot_with_estimated_battery
from aerial_gym.sim2real.identify.least_squares.derivatives import parameter_row, replace_params
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel, comparison_band, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.scene import check_scene
from aerial_gym.sim2real.predict.tolerances import (
    Tolerances,
    tolerances_after_gains,
    tolerances_after_move,
    tolerances_after_scaling,
)

SIGNIFICANT_DIGITS = 6  # Significant digits of parameters in the corrected robot file


@dataclass(frozen=True, kw_only=True)
class LoopSetup:
    """A declared robot with its training and test flights."""

    stated: RobotCfg  # Robot as in its file
    robot: RobotCfg  # Robot with a battery estimated from the training flights if its file has none
    params: ModelParams  # Model declared by the file
    train: Predictor
    test: Predictor
    asked_bandwidth: float  # Requested bandwidth [Hz]

    @property
    def flights(self) -> tuple[Flight, ...]:
        """Return training and test flights."""
        return (*self.train.flights, *self.test.flights)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Return the compared channels."""
        return self.test.channels

    @property
    def bandwidth(self) -> float:
        """Return the comparison bandwidth [Hz]: the requested one, limited by the logs."""
        return self.test.bandwidth

    @property
    def tolerances(self) -> Tolerances:
        """Return the standard deviations of the declared values."""
        return self.train.tolerances


def prepare_comparison(
    robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight], *, bandwidth: float, tolerances: Tolerances
) -> LoopSetup:
    """Return a robot with its flights, ready for comparison; raise ``ConfigError`` or ``DataError`` if it cannot be."""
    check_effects(robot)
    flights, powered = [*train, *test], robot_with_estimated_battery(robot, train)
    band = comparison_band(flights, bandwidth)
    channels = find_channels(flights, band)
    tolerances = tolerances_after_move(tolerances, [note for flight in train for note in flight.notes])
    tolerances = tolerances_after_gains(tolerances, [flight.notes for flight in train])
    tolerances = tolerances_after_scaling(tolerances, train)
    on_train, on_test = (
        Predictor(powered, part, bandwidth=band, channels=channels, tolerances=tolerances) for part in (train, test)
    )
    params = params_from_robot(powered)
    check_scene(tuple(powered.effects), flights)
    return LoopSetup(
        stated=robot, robot=powered, params=params, train=on_train, test=on_test, asked_bandwidth=bandwidth
    )


def final_model_of_robot_file(declared: LoopSetup, selection: SelectionResult) -> ModelParams:
    """Return the final model, with parameters rounded as in the robot file."""
    params, effects = selection.fit.params, selection.effect_names
    values = np.array([float(f"{value:.{SIGNIFICANT_DIGITS}g}") for value in parameter_row(params, effects)])
    return replace_params(declared.robot, params, effects, values)
