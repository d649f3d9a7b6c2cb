"""Our pipeline flies the vehicle of any server of AirSim's API: a `Plant` behind msgpack-rpc.

The simulation is paused, and continues for each step of the flight.  If the server's vehicle is at the mission's start
(mavfi's own server with `--in-flight`), its frame is used: then the flight is bit-identical to one in this process.
"""

import math
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.airsim.cameras import PERSPECTIVE
from mavfi.extras.airsim.frames import flipped, from_pose, from_vector3r, to_pose, turned
from mavfi.extras.airsim.scene import difference, identity, reported
from mavfi.extras.airsim.server import msgpack
from mavfi.mission import Scenario
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.sim.camera import pixel_directions
from mavfi.sim.environments.world import World

_PATIENCE_S = 30.0
_GOODBYE_S = 2.0
_POLL_S = 0.002
_AT_START_M = 0.5
_NOT_REWOUND = "flights on a server of AirSim's API cannot be rewound"
_TOLERANCE_US = 2_000
"""Largest delay of a server that advances in its own period (us)."""


class CallRefusedError(MavfiError):
    """A call that the server answers with an error."""


class Rpc:
    """A connection to a server."""

    def __init__(self, host: str, port: int) -> None:
        self._where = f"airsim://{host}:{port}"
        package = msgpack()
        self._pack = package.Packer(use_bin_type=True).pack
        self._unpacker = package.Unpacker(raw=False)
        self._malformed = package.exceptions.UnpackException
        self._number = 0
        try:
            self._socket = socket.create_connection((host, port), _PATIENCE_S)
        except OSError as error:
            raise BadInputError(
                f"--world: {self._where}: no server there ({error.strerror or error}); start mavfi airsim serve first"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def post(self, method: str, *arguments: Any) -> int:
        """Send a call without awaiting its answer; returns its number."""
        self._number += 1
        try:
            self._socket.sendall(self._pack([0, self._number, method, arguments]))
        except OSError as error:
            raise MavfiError(f"{self._where}: the server is gone ({error.strerror or error})") from None
        return self._number

    def call(self, method: str, *arguments: Any) -> Any:
        """The result of a call.

        Raises:
            CallRefusedError: The server refuses it, or a call that was posted.
            MavfiError: The server is gone, or does not answer.
        """
        number = self.post(method, *arguments)
        while True:
            for answered, error, result in self._answers():
                if error is not None:  # also of a call that was posted
                    refused_call = "refused"
                    if answered == number:
                        refused_call = method
                    raise CallRefusedError(f"{self._where}: {refused_call}: {error}")
                if answered == number:
                    return result
            try:
                data = self._socket.recv(1 << 20)
            except OSError as error:
                raise MavfiError(f"{self._where}: {method}: no answer ({error.strerror or error})") from None
            if not data:
                raise MavfiError(f"{self._where}: the server is gone")
            self._unpacker.feed(data)

    def _answers(self) -> Iterator[tuple[int, Any, Any]]:
        """Number, error and result of the answers received so far."""
        try:
            for _, answered, error, result in self._unpacker:
                yield answered, error, result
        except (TypeError, ValueError, self._malformed):
            raise MavfiError(f"{self._where}: the answer is not one of msgpack-rpc") from None

    def hurry(self) -> None:
        """Do not wait long for answers from now on."""
        self._socket.settimeout(_GOODBYE_S)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class Remote:
    """The vehicle behind a server, as a `Plant`; cameras and odometry only.

    Attributes:
        odometry: See `Plant`.
        collided: See `Plant`.
        rejected_commands: See `Plant`.
        rpc: The connection.

    Raises:
        BadInputError: The mission needs more than the API gives, or the server has another world or vehicle, or images
            of another size; then nothing has changed on the server.
        MavfiError: The server refuses a call, or is gone.
    """

    def __init__(self, world: World, scenario: Scenario, host: str, port: int) -> None:
        if scenario.localization.kind != "truth":
            raise BadInputError("--localization: estimator: allowed: truth, with --world")
        self.rpc = Rpc(host, port)
        self._scenario = scenario
        self._camera = scenario.camera
        self.time_us = 0
        self.collided = False
        self.rejected_commands = 0
        self.odometry = np.zeros(13)
        self._directions = pixel_directions(scenario.camera)
        self._directions.flags.writeable = False
        self._origin = np.zeros(3)
        self._initial_state: tuple[bool, bool] | None = None  # paused, under control of a program
        try:
            self._check(world)
            self._begin_at(world)
        except BaseException:
            self.close()
            raise

    def _check(self, world: World) -> None:
        """Check images, world and vehicle of the server, and change nothing.

        A server that does not report its world and vehicle, as AirSim itself, is trusted.

        Raises:
            BadInputError: They are not those of the flight.
        """
        self.depth()
        try:
            there = reported(self.rpc.call("getSettingsString"))
        except CallRefusedError:
            there = {}
        different = difference(there, identity(self._scenario, world))
        if different:
            raise BadInputError(f"server of --world: {different}; allowed: the same (mavfi airsim serve)")
        wind = self._scenario.wind.gust
        if not there and wind:
            raise BadInputError(f"--wind: {wind:g}: the server has its own wind; allowed: 0, with this server")

    def _begin_at(self, world: World) -> None:
        """Take over the vehicle, at the mission's start."""
        paused = bool(self.rpc.call("simIsPaused"))
        controlled = bool(self.rpc.call("isApiControlEnabled", ""))
        self._initial_state = (paused, controlled)
        self.rpc.call("reset")
        self.rpc.call("enableApiControl", True, "")
        self.rpc.call("simPause", True)
        self.rpc.call("armDisarm", True, "")
        self._observe()
        if float(np.abs(self.odometry[:3] - world.start).max()) > _AT_START_M:
            self._go_to_start(world)
        self._begin = self._stamp

    def _go_to_start(self, world: World) -> None:
        """Put a vehicle that stands elsewhere to the start; its own origin is the ground below that."""
        self._origin = world.start - np.array([0.0, 0.0, world.start[2]])
        course = world.goal - world.start
        yaw = atan2(course[1], course[0])
        facing = turned((cos(0.5 * yaw), 0.0, 0.0, sin(0.5 * yaw)))
        self.rpc.call("simSetVehiclePose", to_pose(flipped(world.start - self._origin), facing), True, "")
        self._observe()
        self.collided = False

    def _observe(self) -> None:
        """Read the state of the vehicle, and the time of the server."""
        state = self.rpc.call("getMultirotorState", "")
        try:
            kinematics = state["kinematics_estimated"]
            self._stamp = int(state["timestamp"])
            velocity = from_vector3r(kinematics["linear_velocity"])
            rates = from_vector3r(kinematics["angular_velocity"])
            self.collided = self.collided or bool(state["collision"]["has_collided"])
        except (KeyError, TypeError, ValueError) as error:
            raise MavfiError(f"server of --world: getMultirotorState: not a MultirotorState ({error!r})") from None
        position, orientation = from_pose(kinematics)
        self.odometry[:3] = np.array(flipped(position)) + self._origin
        self.odometry[3:6] = flipped(velocity)
        self.odometry[6:10] = turned(orientation)
        self.odometry[10:] = flipped(rates)

    @property
    def ray_directions(self) -> np.ndarray:
        """See `Plant.ray_directions`."""
        return self._directions

    def command(self, velocity_yaw_rate: np.ndarray, duration: float) -> None:
        """See `Plant.command`; the yaw rate is also sent in rad/s, for servers that read it."""
        vx, vy, vz, yaw_rate = velocity_yaw_rate.tolist()
        if not all(map(math.isfinite, (vx, vy, vz, yaw_rate, duration))):
            self.rejected_commands += 1
            return
        turning = {"is_rate": True, "yaw_or_rate": math.degrees(-yaw_rate), "rad": -yaw_rate}
        self.rpc.post("moveByVelocity", vx, -vy, -vz, duration, 0, turning, "")

    def advance(self, time_us: int) -> None:
        """See `Plant.advance`.

        Raises:
            MavfiError: The server's time does not pass.
        """
        if time_us <= self.time_us:
            return
        self.rpc.call("simContinueForTime", 1e-6 * (time_us - self.time_us))
        self.time_us = time_us
        end = time.monotonic() + _PATIENCE_S
        self._observe()
        while self._stamp < self._begin + 1000 * (time_us - _TOLERANCE_US):  # AirSim answers before the time has passed
            if time.monotonic() > end:
                raise MavfiError(
                    f"server of --world: its time does not pass (simContinueForTime at {1e-6 * time_us} s)"
                )
            time.sleep(_POLL_S)
            self._observe()

    def depth(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Plant.depth`."""
        request = {
            "camera_name": "0",
            "image_type": PERSPECTIVE,
            "pixels_as_float": True,
            "compress": False,
            "annotation_name": "",
        }
        try:
            image = self.rpc.call("simGetImages", [request], "", False)[0]
            size = image["width"], image["height"]
        except (KeyError, IndexError, TypeError) as error:
            raise MavfiError(f"server of --world: simGetImages: not an ImageResponse ({error!r})") from None
        wanted = self._camera.width, self._camera.height
        if size != wanted:
            text = f"its images are {size[0]}x{size[1]}; allowed: {wanted[0]}x{wanted[1]} (mavfi airsim serve --image)"
            raise BadInputError(f"server of --world: {text}")
        ranges = np.array(image["image_data_float"], np.float32)
        ranges[ranges >= self._camera.range] = np.inf
        return ranges, np.concatenate([self.odometry[:3], self.odometry[6:10]])

    def imu(self) -> np.ndarray:
        """See `Plant.imu`; the server's, with its noise."""
        data = self.rpc.call("getImuData", "", "")
        return np.array(
            [*flipped(from_vector3r(data["linear_acceleration"])), *flipped(from_vector3r(data["angular_velocity"]))]
        )

    def position_fix(self) -> np.ndarray:
        """See `Plant.position_fix`; not offered."""
        raise BadInputError("--localization: estimator: allowed: truth, with --world")

    def warnings(self) -> list[str]:
        """See `Plant.warnings`; the API has none."""
        return []

    def snapshot(self) -> Any:
        """See `Plant.snapshot`; a server cannot be rewound."""
        raise MavfiError(_NOT_REWOUND)

    def restore(self, snapshot: Any) -> None:
        """See `Plant.restore`; a server cannot be rewound."""
        raise MavfiError(_NOT_REWOUND)

    def is_at(self, snapshot: Any) -> bool:
        """See `Plant.is_at`; a server cannot be rewound."""
        raise MavfiError(_NOT_REWOUND)

    def close(self) -> None:
        """See `Plant.close`; the server is paused or not, and under control of a program or not, as it was found."""
        if self._initial_state is not None:
            paused, controlled = self._initial_state
            self._initial_state = None
            self.rpc.hurry()
            with suppress(MavfiError):
                self.rpc.call("enableApiControl", controlled, "")
                self.rpc.call("simPause", paused)
        self.rpc.close()
