"""The open-loop errors of one model alone, for tests."""

from collections.abc import Sequence
from typing import Any

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.replay.load import LoadLink
from aerial_gym.sim2real.predict.rollout import RolloutErrors, rollout_errors_of_models


def roll_out(
    robot: RobotCfg, flights: Sequence[Flight], params: ModelParams, *, links: Sequence[LoadLink] | None = None,
    given_attitude: bool = False, **options: Any,
) -> RolloutErrors:  # fmt: skip
    (result,) = rollout_errors_of_models(robot, flights, [params], {"": given_attitude}, links=[links], **options)
    return result[""]
