"""Free bodies in MuJoCo, one per environment: the common part of MuJoCo on the CPU and MuJoCo Warp.

A body's frame is at its centre of mass, where Newton's and Euler's equations decouple, as in ``integrators``.
Frames: world, z up; body. Letters: E environments, N rows of parameters: 1 if shared by all environments, else E.
"""

from abc import ABC, abstractmethod
from importlib import import_module
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.extras import optional_import
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics.articulated.tree import Links, Tree
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.model import Model
from aerial_gym.physics.mujoco.mjcf import Floor, solver_numbers, write_mjcf
from aerial_gym.physics.vehicle import is_shared

LARGEST = 1e9  # Numbers from here on are not passed to MuJoCo, which logs warnings to a file from 1e10 on
MASS, INERTIA, COM, GRAVITY = 0, slice(1, 10), slice(10, 13), 13  # Columns of `body_rows`


def import_optional(module: str, *, backend: str) -> Any:
    """Import an optional module; raise ``MissingDependencyError`` with its extra if it is not installed."""
    with optional_import(f"backend {backend!r}"):
        return import_module(module)


def principal_axes(mujoco: Any, inertia: Tensor) -> tuple[Tensor, Tensor]:
    """Return principal moments [kg m²], (..., 3), and attitudes of their axes, wxyz, (..., 4), of inertias, float64."""
    moments, axes = torch.linalg.eigh(inertia)
    axes[..., 0] *= torch.linalg.det(axes).sign().unsqueeze(-1)
    turns = torch.zeros(*moments.shape[:-1], 4, dtype=torch.float64)
    for turn, matrix in zip(turns.view(-1, 4).numpy(), axes.reshape(-1, 9).numpy(), strict=True):
        mujoco.mju_mat2Quat(turn, matrix)
    return moments, turns


def body_rows(model: Model) -> Tensor:
    """Return MuJoCo's parameters of each body: mass, inertia, centre of mass and gravity, float64, (N, 14)."""
    vehicle = model.vehicle
    mass, inertia, com = vehicle.mass, vehicle.inertia, vehicle.com
    if all(map(is_shared, (mass, inertia, com))):
        mass, inertia, com = mass[:1], inertia[:1], com[:1]
    gravity = torch.full_like(mass, model.gravity)
    rows = (mass.unsqueeze(-1), inertia.flatten(1), com, gravity.unsqueeze(-1))
    return torch.cat([part.detach().double() for part in rows], dim=-1)


def compile_template_body(mujoco: Any, floor: Floor | None, cfg: ContactCfg | None, dt: float) -> Any:
    """Compile the ``MjModel`` of a free body of 1 kg and 1 kg m² as a template for the numbers of ``body_rows``.

    Args:
        floor: Ground with contact spheres in the body frame of the robot file; None without contact.
    """
    unit = torch.ones(1, 1, dtype=torch.float64)
    links = Links(mass=unit, com=torch.zeros(1, 1, 3), inertia=torch.eye(3).expand(1, 1, 3, 3))
    model = mujoco.MjModel.from_xml_string(write_mjcf(Tree(joints=()), links, gravity=0.0, dt=dt, floor=floor))
    if cfg is not None:
        model.geom_solref[:], model.geom_solimp[:] = solver_numbers(cfg, dt)
    return model


class Bodies(ABC):
    """The bodies of all environments, in steps of one length."""

    dt: float  # Length of a step [s]
    num_rows: int  # Number N of rows of parameters

    @abstractmethod
    def set_parameters(self, rows: Tensor) -> None:
        """Set the parameters of ``body_rows``, (N, 14), which may be unchanged."""

    @abstractmethod
    def _inputs(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the inputs of a step: MuJoCo's qpos (E, 7), qvel (E, 6) and xfrc_applied of the body (E, 6)."""

    @abstractmethod
    def _step(self) -> None:
        """Advance from ``_inputs`` by ``dt``."""

    @abstractmethod
    def _outputs(self) -> tuple[Tensor, Tensor]:
        """Return the outputs of a step: qpos (E, 7) and qvel (E, 6)."""

    def move(self, state: MassState, force: Tensor, torque: Tensor) -> dict[str, Tensor]:
        """Return position, attitude and velocities after a step, by the names of ``MassState``, in the float type of ``state``.

        Rows with a number that is not finite, or beyond ``LARGEST``, become NaN without a step.

        Args:
            force: Constant over the step [N], body axes of its start, (E, 3).
            torque: About the centre of mass [N m], likewise, (E, 3).
        """
        pose, twist, push = self._inputs()
        attitude = state.attitude.to(pose.dtype)
        given = (
            torch.cat((state.position.to(pose.dtype), attitude.roll(1, dims=-1)), dim=-1),
            torch.cat((state.lin_vel, state.ang_vel), dim=-1).to(pose.dtype),
            torch.cat([quat_rotate(attitude, part.to(pose.dtype)) for part in (force, torque)], dim=-1),
        )
        sane = (torch.cat(given, dim=-1).abs() < LARGEST).all(dim=-1, keepdim=True)
        for place, values in zip((pose, twist, push), given, strict=True):
            place.copy_(torch.where(sane, values, 0.0))
        pose[:, 3:4] = torch.where(sane, pose[:, 3:4], 1.0)
        self._step()
        pose, twist = (torch.where(sane, rows, torch.nan).to(state.position.dtype) for rows in self._outputs())
        return {
            "position": pose[:, :3],
            "attitude": pose[:, 3:].roll(-1, dims=-1),
            "lin_vel": twist[:, :3],
            "ang_vel": twist[:, 3:],
        }
