"""A plain twin of the state estimator, and motions with a known solution for it to follow."""

import numpy as np
from scipy.spatial.transform import Rotation

from mavfi.kernels.perception.state_estimation import GRAVITY, NOMINAL_WIDTH, Noise

AIRSIM = Noise(2.354e-3, 8.727e-5, 1.248e-5, 9.97e-7, 0.05, 0.025)
WEIGHT = np.array([0.0, 0.0, -GRAVITY])


def rotation_of(quaternion):
    return Rotation.from_quat(quaternion, scalar_first=True)


def cross(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def heading(rotation):
    matrix = rotation.as_matrix()
    return np.arctan2(matrix[1, 0], matrix[0, 0])


class Twin:
    """Solà's equations with whole matrices."""

    def __init__(self, nominal, covariance, noise):
        self.position, self.velocity = nominal[:3].copy(), nominal[3:6].copy()
        self.attitude = rotation_of(nominal[6:10])
        self.biases = nominal[10:].copy()
        self.covariance, self.noise = covariance.copy(), noise

    def predict(self, sample, dt):
        force, rates = sample[:3] - self.biases[:3], sample[3:] - self.biases[3:]
        body = self.attitude.as_matrix()
        transition = np.eye(15)
        transition[0:3, 3:6] = np.eye(3) * dt
        transition[3:6, 6:9] = -body @ cross(force) * dt
        transition[3:6, 9:12] = -body * dt
        transition[6:9, 6:9] = Rotation.from_rotvec(rates * dt).as_matrix().T
        transition[6:9, 12:15] = -np.eye(3) * dt
        n = self.noise
        added = np.diag(np.repeat([0.0, n.force**2, n.rate**2, n.force_walk**2, n.rate_walk**2], 3)) * dt
        self.covariance = transition @ self.covariance @ transition.T + added
        acceleration = body @ force + WEIGHT
        self.position = self.position + self.velocity * dt + 0.5 * acceleration * dt**2
        self.velocity = self.velocity + acceleration * dt
        self.attitude = self.attitude * Rotation.from_rotvec(rates * dt)

    def correct(self, fix):
        rows = np.zeros((4, 15))
        rows[:3, :3] = np.eye(3)
        step = 1e-6
        for axis in range(3):  # by differences, not by a formula
            turned = [heading(self.attitude * Rotation.from_rotvec(s * step * np.eye(3)[axis])) for s in (1, -1)]
            rows[3, 6 + axis] = np.angle(np.exp(1j * (turned[0] - turned[1]))) / (2 * step)
        innovation = np.append(fix[:3] - self.position, np.angle(np.exp(1j * (fix[3] - heading(self.attitude)))))
        spread = rows @ self.covariance @ rows.T + np.diag([self.noise.position**2] * 3 + [self.noise.heading**2])
        gain = self.covariance @ rows.T @ np.linalg.inv(spread)
        error = gain @ innovation
        self.covariance = (np.eye(15) - gain @ rows) @ self.covariance
        self.position, self.velocity = self.position + error[:3], self.velocity + error[3:6]
        self.attitude = self.attitude * Rotation.from_rotvec(error[6:9])
        self.biases = self.biases + error[9:]
        return innovation @ np.linalg.solve(spread, innovation)

    def difference(self, nominal):
        """Largest difference from a nominal state of the filter."""
        apart = (self.attitude.inv() * rotation_of(nominal[6:10])).magnitude()
        rest = np.concatenate([self.position, self.velocity, self.biases]) - np.delete(nominal, slice(6, 10))
        return max(apart, np.abs(rest).max())


class Motion:
    """A body with constant acceleration in every step: position and velocity by their formulas, attitude by SciPy."""

    def __init__(self, seed, dt=0.004):
        random = np.random.default_rng(seed)
        self.dt, self.time = dt, 0.0
        self.position, self.velocity = random.uniform(-5, 5, 3), np.zeros(3)
        self.attitude = Rotation.from_euler("Z", random.uniform(-3, 3))
        self._swing, self._phase = random.uniform(0.5, 3.0, 6), random.uniform(0, 6, 6)

    def step(self):
        """Advance by dt; gives the true sample of an IMU."""
        wave = np.sin(self._swing * self.time + self._phase)
        acceleration, rates = np.array([2.0, 2.0, 1.0]) * wave[:3], np.array([0.4, 0.4, 0.8]) * wave[3:]
        force = self.attitude.inv().apply(acceleration - WEIGHT)
        self.position = self.position + self.velocity * self.dt + 0.5 * acceleration * self.dt**2
        self.velocity = self.velocity + acceleration * self.dt
        self.attitude = self.attitude * Rotation.from_rotvec(rates * self.dt)
        self.time += self.dt
        return np.concatenate([force, rates])

    @property
    def fix(self):
        return np.append(self.position, heading(self.attitude))

    def error(self, nominal):
        """Errors of position, velocity and attitude as the filter defines them. Shape (9,)."""
        turned = (rotation_of(nominal[6:10]).inv() * self.attitude).as_rotvec()
        return np.concatenate([self.position - nominal[:3], self.velocity - nominal[3:6], turned])


def start_of(motion, error):
    """A nominal state that errs by so much in position, velocity and attitude (shape (9,))."""
    nominal = np.zeros(NOMINAL_WIDTH)
    nominal[:3], nominal[3:6] = motion.position - error[:3], motion.velocity - error[3:6]
    attitude = motion.attitude * Rotation.from_rotvec(-error[6:9])
    nominal[6:10] = attitude.as_quat(scalar_first=True)
    return nominal
