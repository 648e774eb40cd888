"""The controls of the page: pause, speed, environment, push, sticks, effects.

Every control stores a wish or puts a call into ``requests``, which the loop of the flight makes between two steps. Texts of
files reach the page as plain labels, never as HTML.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from aerial_gym.viewer.effects import EffectSwitch
from aerial_gym.viewer.simulation import FlightInView

if TYPE_CHECKING:
    from viser import ViserServer

    from aerial_gym.viewer.scene import SceneView

SPEEDS = ("1", "0.5", "0.25", "0.1", "2", "4")  # Flight time per time
PUSH_M_S = 1.5  # Change of velocity by one push [m/s]
KEY_STEP = 0.2  # Change of a stick by one press of a key
DIRECTIONS = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
AXES = {
    "forward": ("vx ", "ax ", "x ", "pitch", "q "), "left": ("vy ", "ay ", "y ", "roll", "p "),
    "up": ("vz ", "az ", "z ", "thrust - 1", "thrust (0"), "turn": ("yaw", "r "),
}  # fmt: skip
"""Directions of keys: beginnings of the entries of an action that they move."""
RIGHT = ("roll", "p ")  # Beginnings of entries that are positive to the right
KEYS = {"I": ("forward", 1), "K": ("forward", -1), "J": ("left", 1), "L": ("left", -1), "Y": ("up", 1),
        "H": ("up", -1), "U": ("turn", 1), "O": ("turn", -1)}  # fmt: skip


def axis_entry(axis: str, action_names: Sequence[str]) -> tuple[int, int] | None:
    """Return the entry of an action that moves a vehicle along an axis of ``AXES``, and its sign; None without one.

    A positive roll leads to the right, so it is negative for ``left``.
    """
    for number, name in enumerate(action_names):
        if name.startswith(AXES[axis]):
            return number, -1 if name.startswith(RIGHT) else 1
    return None


class ControlPanel:
    """The controls and what they ask for."""

    def __init__(self, server: "ViserServer", flight: FlightInView, scene: "SceneView") -> None:
        """Add the controls to the page."""
        self._gui, self._flight, self._scene = server.gui, flight, scene
        self.requests: deque[Callable[[], object]] = deque()
        """Calls that the loop makes between two steps."""
        self.paused, self.single_steps, self.speed = False, 0, 1.0
        self.shows_forces = True
        self._status = self._gui.add_text("state", "", disabled=True, hint="time of the episode, height, speed")
        self._add_time()
        self._add_view()
        self._add_disturbances()
        self._sticks = self._add_sticks()
        if flight.effects:
            with self._gui.add_folder("effects"):
                for switch in flight.effects:
                    self._add_effect(switch)

    def show_state(self, text: str) -> None:
        """Show one line about the flight."""
        if self._status.value != text:
            self._status.value = text

    def _add_time(self) -> None:
        pause = self._gui.add_checkbox("pause", initial_value=False, hint="key P")
        pause.on_update(lambda _: setattr(self, "paused", pause.value))
        step = self._gui.add_button("single step", hint="key N")
        speed = self._gui.add_dropdown("speed", SPEEDS, initial_value="1", hint="flight time per time")
        speed.on_update(lambda _: setattr(self, "speed", float(speed.value)))
        reset = self._gui.add_button("reset")

        def step_once(_: object) -> None:
            pause.value = self.paused = True
            self.single_steps += 1

        def switch_pause(_: object) -> None:
            pause.value = self.paused = not self.paused

        step.on_click(step_once)
        reset.on_click(lambda _: self.requests.append(self._flight.reset))
        self._gui.add_command("pause or go on", hotkey="P").on_trigger(switch_pause)
        self._gui.add_command("single step", hotkey="N").on_trigger(step_once)

    def _add_view(self) -> None:
        flight, scene = self._flight, self._scene
        if flight.env.num_envs > 1:
            number = self._gui.add_number("environment", 0, min=0, max=flight.env.num_envs - 1, step=1)
            number.on_update(lambda _: flight.choose(int(number.value)))
            show = self._gui.add_checkbox("other vehicles", initial_value=True)
            show.on_update(lambda _: setattr(scene.others, "visible", show.value))
        scene.add_follow_switch(follows=flight.has_task)
        forces = self._gui.add_checkbox("forces of effects", initial_value=True)
        forces.on_update(lambda _: setattr(self, "shows_forces", forces.value))
        if scene.content.parts:
            walls = self._gui.add_checkbox("walls", initial_value=False)

            def show_walls(_: object) -> None:
                scene.shows_walls = walls.value
                self.requests.append(scene.redraw_obstacles)

            walls.on_update(show_walls)

    def _add_disturbances(self) -> None:
        flight = self._flight
        push = self._gui.add_button_group("push", tuple(DIRECTIONS), hint=f"{PUSH_M_S:g} m/s; or drag the vehicle")

        def push_vehicle(_: object) -> None:
            x, y, z = DIRECTIONS[push.value]
            self.requests.append(lambda: flight.push((PUSH_M_S * x, PUSH_M_S * y, PUSH_M_S * z)))

        push.on_click(push_vehicle)
        self._scene.vehicle.on_drag(lambda pointer: setattr(flight, "pull", pointer))

        def move_goal(event: object) -> None:
            if getattr(event, "client_id", None) is not None:
                x, y, z = (float(value) for value in self._scene.goal.position)
                self.requests.append(lambda: flight.move_goal((x, y, z)))

        self._scene.goal.on_update(move_goal)

    def _add_sticks(self) -> list:
        flight = self._flight
        with self._gui.add_folder("fly by hand", expand_by_default=False):
            hand = self._gui.add_checkbox("by hand", initial_value=False, hint="by the sticks here, or by keys")
            hand.on_update(lambda _: setattr(flight, "by_hand", hand.value))
            sticks = [self._gui.add_slider(name, -1.0, 1.0, 0.01, 0.0) for name in flight.action_names]
            centre = self._gui.add_button("centre the sticks", hint="key C")
        for number, stick in enumerate(sticks):
            stick.on_update(lambda _, number=number, stick=stick: self._set_stick(number, stick.value))
        self._hand = hand

        def release(_: object) -> None:
            for stick in sticks:
                stick.value = 0.0

        centre.on_click(release)
        self._gui.add_command("centre the sticks", hotkey="C").on_trigger(release)
        for key, (axis, sign) in KEYS.items():
            entry = axis_entry(axis, flight.action_names)
            if entry is not None:
                number, turns = entry
                name = f"{'-' if sign * turns < 0 else '+'} {flight.action_names[number]}"
                command = self._gui.add_command(name, hotkey=key)  # pyright: ignore[reportArgumentType]
                change = sign * turns * KEY_STEP
                command.on_trigger(lambda _, number=number, change=change: self._nudge(number, change))
        return sticks

    def _set_stick(self, number: int, value: float) -> None:
        self._flight.sticks[number] = value

    def _nudge(self, entry: int, change: float) -> None:
        """Move a stick by a key, and fly by hand from then on."""
        self._hand.value = self._flight.by_hand = True
        value = self._sticks[entry].value + change
        self._sticks[entry].value = min(max(round(value, 2), -1.0), 1.0)

    def _add_effect(self, switch: EffectSwitch) -> None:
        name = switch.effect.name
        with self._gui.add_folder(name, expand_by_default=switch.is_on):
            on = self._gui.add_checkbox("on", initial_value=switch.is_on, hint=switch.effect.summary)

            def turn(_: object) -> None:
                switch.is_on = on.value
                self.requests.append(switch.apply)

            on.on_update(turn)
            for number, parameter in enumerate(switch.effect.parameters):
                low, high = switch.limits(number)
                if parameter.kind == "rotor":
                    high = float(self._flight.env.robot_manager.cfg.num_rotors)
                step = 1.0 if parameter.kind == "rotor" else (high - low) / 100.0
                label = f"{parameter.name} [{parameter.unit}]"
                slider = self._gui.add_slider(label, low, high, step, switch.values[number], hint=parameter.meaning)

                def change(_: object, number: int = number, slider=slider) -> None:
                    switch.values[number] = float(slider.value)
                    if switch.is_on:
                        self.requests.append(switch.apply)

                slider.on_update(change)
