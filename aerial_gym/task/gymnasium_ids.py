"""Gymnasium's ids of tasks, by one rule: ``position_setpoint_task`` is ``aerial_gym/PositionSetpoint-v0``.

Gymnasium 0.29 finds them by the entry point group ``gymnasium.envs``. Gymnasium 1 reads no entry points: there ``import
aerial_gym`` registers them, before or after ``import gymnasium``. Neither imports torch.
"""

import logging
import sys

ADAPTER = "aerial_gym.rl_training.gymnasium"  # Module that makes the environments

_log = logging.getLogger(__name__)


def gymnasium_id(name: str) -> str:
    """Return the id of a task: the words of its name without ``task``, each with a capital letter."""
    words = (word for word in name.split("_") if word != "task")
    return f"aerial_gym/{''.join(word[:1].upper() + word[1:] for word in words)}-v0"


def register_task(name: str) -> None:
    """Register a task with Gymnasium, if that is imported. Of two names with one id, the first keeps it, with a warning."""
    registration = sys.modules.get("gymnasium.envs.registration")
    if registration is None or not name.isidentifier():  # Gymnasium refuses other characters
        return
    single, vector, known = f"{ADAPTER}:single.{name}", f"{ADAPTER}:vector.{name}", gymnasium_id(name)
    if known not in registration.registry:
        registration.register(id=known, entry_point=single, vector_entry_point=vector)
    elif registration.registry[known].entry_point != single:
        _log.warning("task %r: Gymnasium's id %s is taken. Rename the task for an id of its own", name, known)


def register_tasks() -> None:
    """Register every task; the entry point of the group ``gymnasium.envs``."""
    from aerial_gym.task.catalog import task_registry

    for name in task_registry:
        register_task(name)
