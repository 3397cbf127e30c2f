"""The linearised Whipple bicycle: how an ideal bicycle leans and steers near straight, upright rolling.

After Meijaard, Papadopoulos, Ruina and Schwab, *Linearized dynamics equations for the balance and steer of a bicycle:
a benchmark and review*, Proc. R. Soc. A 463 (2007), appendix A, with its symbols. For q = (phi, delta), lean to the
right and steer to the **right** as there,

    M q'' + v C1 q' + (g K0 + v^2 K2) q = f,

with knife-edge wheels that roll without slipping. The paper's axes are x forward, y right, z **down**; the parameters
here are in ours (see `echelon.agents.riders.bicycle`), so z and every x z product change sign on the way in.

The engine's bicycle, with compliant tyres, is measured against these eigenvalues by `echelon bench bicycle`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from echelon.agents.riders.bicycle import BicycleParameters, RigidPart, WheelParameters


@dataclass(frozen=True)
class LinearBicycle:
    """Matrices of the equations of motion of (lean, steer), each of shape [2, 2].

    Attributes:
        M: Mass matrix [kg m^2].
        C1: Damping over speed [kg m].
        K0: Stiffness over gravity [kg m].
        K2: Stiffness over the square of speed [kg].
        C0: Damping that does not depend on speed, from the steering bearing [N m s/rad].
        gravity: [m/s^2].
    """

    M: np.ndarray
    C1: np.ndarray
    K0: np.ndarray
    K2: np.ndarray
    C0: np.ndarray
    gravity: float

    def state_matrix(self, speed: float) -> np.ndarray:
        """A of x' = A x for x = (lean, steer, and their rates) at a forward speed [m/s], shape [4, 4]."""
        A = np.zeros((4, 4))
        A[:2, 2:] = np.eye(2)
        A[2:, :2] = -np.linalg.solve(self.M, self.gravity * self.K0 + speed**2 * self.K2)
        A[2:, 2:] = -np.linalg.solve(self.M, self.C0 + speed * self.C1)
        return A

    def eigenvalues(self, speed: float) -> np.ndarray:
        """The four eigenvalues at a forward speed [1/s], complex, the largest real part first."""
        return in_order(np.linalg.eigvals(self.state_matrix(speed)))


def in_order(eigenvalues: np.ndarray) -> np.ndarray:
    """Eigenvalues by falling real part, of a conjugate pair the one with the positive imaginary part first."""
    values = np.asarray(eigenvalues, dtype=complex)
    return values[np.lexsort((-np.imag(values), -np.round(np.real(values), 9)))]


def linear_bicycle(parameters: BicycleParameters) -> LinearBicycle:
    """The linearised equations of a bicycle, rider rigid, ideal wheels."""
    p = parameters
    w, c, lam = p.wheelbase, p.trail, p.steer_tilt
    x_B, z_B, I_B = _part(p.frame)
    x_H, z_H, I_H = _part(p.fork)
    m_B, m_H = p.frame.mass, p.fork.mass
    r_R, m_R, I_Rxx, I_Ryy = _wheel(p.rear_wheel)
    r_F, m_F, I_Fxx, I_Fyy = _wheel(p.front_wheel)

    # Whole bicycle, about the rear contact.
    m_T = m_R + m_B + m_H + m_F
    x_T = (x_B * m_B + x_H * m_H + w * m_F) / m_T
    z_T = (-r_R * m_R + z_B * m_B + z_H * m_H - r_F * m_F) / m_T
    I_Txx = I_Rxx + I_B[0, 0] + I_H[0, 0] + I_Fxx + m_R * r_R**2 + m_B * z_B**2 + m_H * z_H**2 + m_F * r_F**2
    I_Txz = I_B[0, 2] + I_H[0, 2] - m_B * x_B * z_B - m_H * x_H * z_H + m_F * w * r_F
    I_Tzz = I_Rxx + I_B[2, 2] + I_H[2, 2] + I_Fxx + m_B * x_B**2 + m_H * x_H**2 + m_F * w**2

    # Front assembly A, fork and front wheel, about its own centre of mass and the steer axis.
    m_A = m_H + m_F
    x_A = (x_H * m_H + w * m_F) / m_A
    z_A = (z_H * m_H - r_F * m_F) / m_A
    I_Axx = I_H[0, 0] + I_Fxx + m_H * (z_H - z_A) ** 2 + m_F * (r_F + z_A) ** 2
    I_Axz = I_H[0, 2] - m_H * (x_H - x_A) * (z_H - z_A) + m_F * (w - x_A) * (r_F + z_A)
    I_Azz = I_H[2, 2] + I_Fxx + m_H * (x_H - x_A) ** 2 + m_F * (w - x_A) ** 2
    sin, cos = math.sin(lam), math.cos(lam)
    u_A = (x_A - w - c) * cos - z_A * sin
    I_All = m_A * u_A**2 + I_Axx * sin**2 + 2.0 * I_Axz * sin * cos + I_Azz * cos**2
    I_Alx = -m_A * u_A * z_A + I_Axx * sin + I_Axz * cos
    I_Alz = m_A * u_A * x_A + I_Axz * sin + I_Azz * cos

    mu = c / w * cos
    S_R, S_F = I_Ryy / r_R, I_Fyy / r_F
    S_T = S_R + S_F
    S_A = m_A * u_A + mu * m_T * x_T

    M_pd = I_Alx + mu * I_Txz
    M = np.array([[I_Txx, M_pd], [M_pd, I_All + 2.0 * mu * I_Alz + mu**2 * I_Tzz]])
    K0 = np.array([[m_T * z_T, -S_A], [-S_A, -S_A * sin]])
    K2 = np.array([[0.0, (S_T - m_T * z_T) / w * cos], [0.0, (S_A + S_F * sin) / w * cos]])
    C1 = np.array(
        [
            [0.0, mu * S_T + S_F * cos + I_Txz / w * cos - mu * m_T * z_T],
            [-(mu * S_T + S_F * cos), I_Alz / w * cos + mu * (S_A + I_Tzz / w * cos)],
        ]
    )
    return LinearBicycle(M, C1, K0, K2, np.diag([0.0, p.fork_damping]), p.gravity)


def _part(part: RigidPart) -> tuple[float, float, np.ndarray]:
    """x, z down, and the inertia tensor of a rigid part in the paper's axes."""
    inertia = np.array(part.inertia)
    inertia[0, 2] = inertia[2, 0] = -inertia[0, 2]
    return part.com[0], -part.com[2], inertia


def _wheel(wheel: WheelParameters) -> tuple[float, float, float, float]:
    return wheel.radius, wheel.mass, wheel.inertia_x, wheel.inertia_y
