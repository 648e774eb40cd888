"""The five registries of the Aerial Gym Simulator in front of ours.

A name is looked up in the script's entries, then in those of this package. A class is translated when something is built,
so that earlier changes to it count, as in that simulator. Only scripts see their entries; ``aerial_gym.ROBOTS`` and the
other registries stay unchanged.
"""

from collections.abc import Callable, Mapping
from inspect import isclass
from typing import Any, NoReturn

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.compat.config import controllers, environments, robots, sims, tasks
from aerial_gym.compat.config.fields import ConfigTable, copy_class
from aerial_gym.config.randomize import Randomize
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS
from aerial_gym.env_manager.sim_builder import environment_by_name
from aerial_gym.errors import CapabilityError, ConfigError, DuplicateNameError, UnknownNameError, suggest_name
from aerial_gym.registry import Registry
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.task import task_registry as TASKS  # noqa: N812 (as the other registries of ours)


class ScriptRegistry:
    """Entries of a script and of this package's registry."""

    kind: str
    native: Registry[Any]
    built_in: Mapping[str, Any] = {}

    def __init__(self) -> None:
        self._own: dict[str, Any] = {}

    def _add_entry(self, name: str, entry: Any, identity: Any) -> None:
        """Add an entry; repeating the same class has no effect, another one under the same name is an error."""
        known = self._own.get(name, (self.built_in.get(name), None))[0]
        if name in self.native if known is None else not _is_same_class(known, identity):
            raise DuplicateNameError(f"{self.kind} {name!r} is registered already as something else. Choose another")
        self._own[name] = (identity, entry)

    def names(self) -> list[str]:
        """Return all names, sorted."""
        return sorted({*self._own, *self.built_in, *self.native})

    def _script_entry(self, name: str) -> Any:
        """Return the script's entry of a name, None for a name of this package; else raise ``UnknownNameError``."""
        if name in self._own:
            return self._own[name][1]
        if name in self.built_in or name in self.native:
            return None
        names = self.names()
        raise UnknownNameError(f"no {self.kind} {name!r}.{suggest_name(name, names)} Known: {', '.join(names)}")


def _is_same_class(a: Any, b: Any) -> bool:
    """Return whether two classes are one, or one that a notebook has defined again."""
    return a is b or (isclass(a) and isclass(b) and (a.__module__, a.__qualname__) == (b.__module__, b.__qualname__))


def _is_file(name: object) -> bool:
    return str(name).endswith((".yaml", ".yml"))


class ConfigClassRegistry(ScriptRegistry):
    """A registry of configuration classes."""

    table: ConfigTable
    translate: Callable[[Any], Any]
    load: Callable[[Any], Any]

    def config_class(self, name: str) -> Any:
        """Return the configuration class of a name: the script's, or one generated from this package's entry or file."""
        entry = None if _is_file(name) else self._script_entry(name)
        if entry is not None:
            return entry if isclass(entry) else self.table.make_class(name, entry)
        return self.built_in[name] if name in self.built_in else self.table.make_class(str(name), self.load(name))

    def native_config(self, name: str) -> Any:
        """Return this package's configuration for a name; its own names and files unchanged."""
        entry = None if _is_file(name) else self._script_entry(name)
        if entry is None:
            entry = self.built_in.get(name)
        return self.translate(entry) if isclass(entry) else entry or name


class SimConfigRegistry(ConfigClassRegistry):
    """``sim_config_registry``."""

    kind, native, built_in, table = "sim", SIMS, sims.CLASSES, sims.TABLE
    translate, load = staticmethod(sims.translate_sim), staticmethod(SIMS.get)

    def register(self, sim_name: str, sim_config: Any) -> None:
        """Register a sim class, or a ``SimCfg``; another one under a registered name is refused."""
        self._add_entry(sim_name, sim_config, sim_config)

    def get_sim_config(self, sim_name: str) -> Any:
        """Return the sim class."""
        return self.config_class(sim_name)

    get_sim_names, make_sim = ScriptRegistry.names, get_sim_config  # Nothing is built, as there


class EnvConfigRegistry(ConfigClassRegistry):
    """``env_config_registry``."""

    kind, native, built_in, table = "environment", ENVIRONMENTS, environments.CLASSES, environments.TABLE
    translate, load = staticmethod(environments.translate_environment), staticmethod(environment_by_name)

    def register(self, env_name: str, env_config: Any) -> None:
        """Register an environment class, or an ``EnvironmentCfg``; another one under a registered name is refused."""
        self._add_entry(env_name, env_config, env_config)

    def get_env_config(self, env_name: str) -> Any:
        """Return the environment class."""
        return self.config_class(env_name)

    get_env_names, make_env = ScriptRegistry.names, get_env_config  # Nothing is built, as there


ROBOT_CLASSES: dict[str, type] = {
    name: type(name, (), {"__doc__": "Stand-in for a class of robots; the robot file determines how one flies."})
    for name in ("BaseMultirotor", "BaseReconfigurable", "BaseROV", "Morphy")
}
"""Robot classes of that simulator by name; joints, soft arms and water are in the robot file here."""
BaseMultirotor = ROBOT_CLASSES["BaseMultirotor"]


class RobotRegistry(ConfigClassRegistry):
    """``robot_registry``."""

    kind, native, built_in, table = "robot", ROBOTS, robots.CLASSES, robots.TABLE
    translate, load = staticmethod(robots.translate_robot), staticmethod(robot_by_name)

    def register(self, robot_name: str, robot_class: type, robot_config: Any) -> None:
        """Register a robot class, or a ``RobotCfg``; another one under a registered name is refused.

        Raises:
            ConfigError: If the class of the robot is one of the script's own.
        """
        if robot_class not in ROBOT_CLASSES.values():
            raise ConfigError(
                f"robot class {getattr(robot_class, '__name__', robot_class)}: robots have no code of their own here; use "
                "BaseMultirotor. What acts on a body is an effect (aerial_gym.physics.effects)"
            )
        self._add_entry(robot_name, robot_config, robot_config)

    def get_robot_class(self, robot_name: str) -> type:
        """Return ``BaseMultirotor``."""
        self._script_entry(robot_name)
        return BaseMultirotor

    def get_robot_config(self, robot_name: str) -> Any:
        """Return the robot class."""
        return self.config_class(robot_name)

    get_robot_names = ScriptRegistry.names

    def make_robot(self, robot_name: str, *_: object, **__: object) -> NoReturn:
        """Refuse: a robot is built with its environment."""
        raise CapabilityError(
            f"make_robot({robot_name!r}): a robot is built with its environment here; use SimBuilder().build_env"
        )


class ControllerRegistry(ScriptRegistry):
    """``controller_registry``."""

    kind, native = "controller", CONTROLLERS

    def register_controller(self, controller_name: str, controller_class: Any, controller_config: Any) -> None:
        """Register a control law by its class in that simulator, with a class of gains."""
        controllers.translate_controller(controller_class, controller_config)
        self._add_entry(controller_name, (controller_class, controller_config), controller_config)

    get_controller_names = ScriptRegistry.names

    def get_controller_class(self, controller_name: str) -> Any:
        """Return the law's class in that simulator; None for laws of this package alone."""
        entry = self._script_entry(controller_name)
        if entry is not None:
            return entry[0]
        return next((law for law in controllers.LAWS.values() if law.name == controller_name), None)

    def get_controller_config(self, controller_name: str) -> Any:
        """Return the class of gains."""
        entry = self._script_entry(controller_name)
        return controllers.control if entry is None else entry[1]

    def make_controller(self, controller_name: str, *_: object, **__: object) -> NoReturn:
        """Refuse: a controller is built with its robot."""
        raise CapabilityError(
            f"make_controller({controller_name!r}): a controller is built with its robot here; use SimBuilder().build_env"
        )

    def native_controller(self, name: str) -> Any:
        """Return this package's controller for a name; its own names unchanged."""
        classes = self._law_and_gains(name)
        return name if classes is None else controllers.translate_controller(*classes)

    def gain_randomization(self, name: str) -> Randomize:
        """Return the random gains of a controller, by the names of ``randomize:``."""
        classes = self._law_and_gains(name)
        return {} if classes is None else controllers.gain_randomization(*classes)

    def _law_and_gains(self, name: str) -> tuple[Any, Any] | None:
        """Return the classes of law and gains; None for a controller of this package with the robot's gains."""
        entry = self._script_entry(name)
        if entry is not None:
            return entry
        law = self.get_controller_class(name)
        return (law, controllers.control) if law is not None and controllers.control_is_changed() else None


class TaskRegistry(ScriptRegistry):
    """``task_registry``."""

    kind, native = "task", TASKS

    def register_task(self, task_name: str, task_class: type, task_config: Any) -> None:
        """Register a task class with its configuration; another class under a registered name is refused."""
        self._add_entry(task_name, (task_class, task_config), task_class)

    get_task_names = ScriptRegistry.names

    def get_task_class(self, task_name: str) -> type:
        """Return the task class."""
        entry = self._script_entry(task_name)
        if entry is not None:
            return entry[0]
        from aerial_gym.compat.native_task import task_class

        return task_class(task_name)

    def get_task_config(self, task_name: str) -> Any:
        """Return the configuration class."""
        entry = self._script_entry(task_name)
        return tasks.task_class_config(task_name) if entry is None else entry[1]

    def get_task_classes(self) -> list[type]:
        """Return the class of every task."""
        return [self.get_task_class(name) for name in self.names()]

    def get_task_configs(self) -> list[Any]:
        """Return the configuration class of every task."""
        return [self.get_task_config(name) for name in self.names()]

    def make_task(
        self, task_name: str, seed: int | None = None, num_envs: int | None = None, headless: bool | None = None,
        use_warp: bool | None = None, **more: Any,
    ) -> Any:  # fmt: skip
        """Return a task; ``device`` and other arguments of its class may follow. The class gets a configuration of its own, so
        that its writes, usual in that simulator, reach no other task."""
        given = {"seed": seed, "num_envs": num_envs, "headless": headless, "use_warp": use_warp}
        return self.get_task_class(task_name)(copy_class(self.get_task_config(task_name)), **given, **more)


sim_config_registry = SimConfigRegistry()
env_config_registry = EnvConfigRegistry()
robot_registry = RobotRegistry()
controller_registry = ControllerRegistry()
task_registry = TaskRegistry()
