"""Actuators of MJCF files that push at a site, as rotors.

An actuator gives the scalar ``p = clip(g a + b, forcerange)`` for an activation a: the control itself, its first-order lag
(filter), or its integral. With the gear ``(f, t)`` the body feels the force ``p f`` and the torque ``p t`` in the frame of the
site. That is a rotor of axis f and thrust ``|f| p``, whose torque along f gives the torque ratio. A torque across f is that of
the same force on a line beside the site, at ``f x t / |f|²`` from it.

Gain and bias at rest are ``gainprm[0]`` and, of an affine bias, ``biasprm[0]``: the length of a site without reference is 0.

Source: MuJoCo documentation, XML reference, actuator/general (trntype site, gear, dyntype, gaintype, biastype); computation,
"Actuation model".
"""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np

from aerial_gym.config.robot import RotorCfg
from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import FileRotor

WAY_OUT = "Take rotors of a robot file: --rotors-of ROBOT, rotors_of of RotorHints"


class Actuator:
    """One actuator of a model."""

    def __init__(self, mujoco: Any, model: Any, index: int, where: str) -> None:
        self.mujoco, self.model, self.index = mujoco, model, index
        self.name: str = model.actuator(index).name or f"actuator_{index}"
        self.at = f"{where}: actuator {self.name!r}"
        self.source = f"{where}: gear, gain, ranges"
        self.site = int(model.actuator_trnid[index][0])

    def _has_kind(self, field: str, enum: str, *names: str) -> bool:
        kinds = getattr(self.mujoco, enum)
        return int(getattr(self.model, f"actuator_{field}")[self.index]) in [
            int(getattr(kinds, name)) for name in names
        ]

    @property
    def can_push_vehicle(self) -> bool:
        """Whether the actuator can act on the whole vehicle: at a site, or at its free joint."""
        if self._has_kind("trntype", "mjtTrn", "mjTRN_JOINT", "mjTRN_JOINTINPARENT"):
            free = int(self.mujoco.mjtJoint.mjJNT_FREE)
            return int(self.model.jnt_type[int(self.model.actuator_trnid[self.index][0])]) == free
        return self._has_kind("trntype", "mjtTrn", "mjTRN_SITE")

    @property
    def at_site(self) -> bool:
        """Whether the actuator acts at a site."""
        return self._has_kind("trntype", "mjtTrn", "mjTRN_SITE")

    @property
    def is_enabled(self) -> bool:
        """Whether the file leaves it switched on."""
        option, bits = self.model.opt, self.mujoco.mjtDisableBit
        group = int(self.model.actuator_group[self.index])
        off = bool(option.disableflags & int(bits.mjDSBL_ACTUATION))
        return not off and not (0 <= group <= 30 and int(option.disableactuator) >> group & 1)

    @property
    def has_force(self) -> bool:
        """Whether the actuator acts at a site with a force, not a torque alone."""
        return self.at_site and bool(np.any(self._gear_wrench()[0]))

    def check(self) -> None:
        """Raise ``ConfigError`` unless the actuator is equivalent to a rotor."""
        if not self.at_site:
            raise ConfigError(f"{self.at}: pushes at no site, and only such actuators are rotors. {WAY_OUT}")
        if int(self.model.actuator_trnid[self.index][1]) >= 0:
            raise ConfigError(
                f"{self.at}: its force is relative to a refsite, and a rotor's is along its own body's axes. {WAY_OUT}"
            )
        known = self._has_kind("gaintype", "mjtGain", "mjGAIN_FIXED", "mjGAIN_AFFINE")
        known &= self._has_kind("biastype", "mjtBias", "mjBIAS_NONE", "mjBIAS_AFFINE")
        known &= self._has_kind(
            "dyntype", "mjtDyn", "mjDYN_NONE", "mjDYN_INTEGRATOR", "mjDYN_FILTER", "mjDYN_FILTEREXACT"
        )
        if not known or int(self.model.actuator_plugin[self.index]) >= 0:
            raise ConfigError(
                f"{self.at}: gain and bias must be fixed or affine, and dynamics none, integrator, filter or filterexact. "
                f"{WAY_OUT}"
            )
        if not self.has_force:
            raise ConfigError(
                f"{self.at}: gives a torque and no force, so that it represents several rotors, whose positions the file "
                f"lacks. {WAY_OUT}"
            )

    def _gear_wrench(self) -> tuple[np.ndarray, np.ndarray]:
        force, torque = np.split(np.asarray(self.model.actuator_gear[self.index], dtype=float), 2)
        return force, torque

    def thrust_line(self, pose: np.ndarray) -> FileRotor:
        """Return position and direction of the thrust, for the frame (4, 4) of the site."""
        force, torque = (pose[:3, :3] @ part for part in self._gear_wrench())
        square = float(force @ force)
        place = pose[:3, 3] + np.cross(force, torque) / square
        return FileRotor(name=self.name, position=place, axis=force / square**0.5)

    def rotor(self, pose: np.ndarray, lag: float | None, link: str = BASE) -> FileRotor:
        """Return the equivalent rotor for the frame (4, 4) of its site; ``lag`` [s] is for files without one."""
        force, torque = self._gear_wrench()
        low, high = self._force_range()
        line, turned = self.thrust_line(pose), high <= 0.0  # a control below 0 pushes the other way
        if turned:
            low, high = -high, -low
        size = float(np.linalg.norm(force))
        along = float(torque @ force) / size**2
        return replace(
            line, axis=-line.axis if turned else line.axis, spin=-1 if along > 0.0 else 1,
            rotor=self._rotor_type((size * low, size * high), abs(along), lag), link=link,
        )  # fmt: skip

    def lines_on_unused(self) -> Iterator[str]:
        """Yield the unused attributes of this actuator."""
        m, i = self.model, self.index
        if self._has_kind("biastype", "mjtBias", "mjBIAS_AFFINE") and m.actuator_biasprm[i][2] != 0.0:
            yield f"biasprm[2] = {m.actuator_biasprm[i][2]:g}, force per velocity along the gear, of actuators"
        if self._has_kind("gaintype", "mjtGain", "mjGAIN_AFFINE") and m.actuator_gainprm[i][2] != 0.0:
            yield f"gainprm[2] = {m.actuator_gainprm[i][2]:g}, gain per velocity along the gear, of actuators"
        if m.actuator_armature[i] or m.actuator_damping[i]:
            yield "armature and damping of actuators"

    def assumptions(self) -> Iterator[str]:
        """Yield the attributes of this actuator that the import changes."""
        force, torque = self._gear_wrench()
        beside = float(np.linalg.norm(np.cross(force, torque)) / (force @ force))
        if beside > 0.0:
            yield f"thrust {beside:.4g} m beside the site, in place of a torque across it, of actuators"
        if self._has_kind("dyntype", "mjtDyn", "mjDYN_INTEGRATOR"):
            yield "commands of thrust, in place of its rate (dyntype integrator), of actuators"

    @property
    def delay(self) -> float:
        """Dead time of its control [s]."""
        return float(self.model.actuator_delay[self.index])

    def _force_range(self) -> tuple[float, float]:
        """Return lowest and highest scalar force for the activations and forces that the file allows."""
        m, i = self.model, self.index
        clamped = not m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
        limits = [(-inf, inf)]
        if m.actuator_ctrllimited[i] and clamped and not self._has_kind("dyntype", "mjtDyn", "mjDYN_INTEGRATOR"):
            limits.append(m.actuator_ctrlrange[i])
        if m.actuator_actlimited[i] and not self._has_kind("dyntype", "mjtDyn", "mjDYN_NONE"):
            limits.append(m.actuator_actrange[i])
        ends = np.array([max(low for low, _ in limits), min(high for _, high in limits)], dtype=float)
        gain = float(m.actuator_gainprm[i][0])
        bias = float(m.actuator_biasprm[i][0]) if self._has_kind("biastype", "mjtBias", "mjBIAS_AFFINE") else 0.0
        if gain == 0.0:
            raise ConfigError(f"{self.at}: its force does not follow its control (gainprm[0] = 0). {WAY_OUT}")
        low, high = sorted((gain * ends + bias).tolist())
        if m.actuator_forcelimited[i]:
            low, high = (float(value) for value in np.clip((low, high), *m.actuator_forcerange[i]))
        if not -inf < low < high < inf:
            raise ConfigError(
                f"{self.at}: its force is {low:g} to {high:g} by gain, bias, ctrlrange, actrange and forcerange: must be two "
                "finite limits, low < high. Give it a ctrlrange (an actrange if it is an integrator) or a forcerange"
            )
        return low, high

    def _rotor_type(self, limits: tuple[float, float], ratio: float, lag: float | None) -> RotorCfg:
        own = float(self.model.actuator_dynprm[self.index][0])
        source = self.source
        if self._has_kind("dyntype", "mjtDyn", "mjDYN_FILTER", "mjDYN_FILTEREXACT") and own > 0.0:
            lag, source = own, f"{source}; lag: dynprm"
        elif lag is None:
            raise ConfigError(
                f"{self.at}: its thrust has no first-order lag in the file, and rotors have one. Give it (--lag-s, lag of "
                "RotorHints), measured or that of a similar motor: 0.02 to 0.1 s"
            )
        else:
            source = f"{source}; lag of {lag:g} s: given when it was imported"
        up, down = self._slew_rates(limits)
        return RotorCfg(
            mode="force", torque_ratio=ratio, time_constant_up=lag, time_constant_down=lag, thrust_range=limits,
            slew_rate=up, slew_rate_down=down, source=source,
        )  # fmt: skip

    def _slew_rates(self, limits: tuple[float, float]) -> tuple[float | None, float | None]:
        """Return the largest rates of thrust [N/s] of an integrator whose control has a limit either way; None elsewhere."""
        m, i = self.model, self.index
        if not (
            self._has_kind("dyntype", "mjtDyn", "mjDYN_INTEGRATOR") and m.actuator_ctrllimited[i] and limits[0] >= 0.0
        ):
            return None, None
        per_control = float(m.actuator_gainprm[i][0]) * float(np.linalg.norm(self._gear_wrench()[0]))
        if self._force_range()[1] <= 0.0:
            per_control = -per_control
        low, high = sorted((per_control * np.asarray(m.actuator_ctrlrange[i])).tolist())
        return (high, -low) if low < 0.0 < high else (None, None)
