"""A client that talks to an autopilot in the same process, through packets, in simulated time."""

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavfi.extras.mavlink.flying import MavVehicle
from mavfi.extras.mavlink.px4 import FlightMode
from mavfi.extras.mavlink.server import DIALECTS
from mavfi.extras.mavlink.vocabulary import MavResult
from mavfi.mission import MissionSpec

NAN = math.nan


class Client:
    """Talks to an autopilot in the same process."""

    def __init__(self, dialect="px4"):
        self.received = []
        self._parser = mavlink.MAVLink(None)
        self._link = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        self.vehicle = MavVehicle(MissionSpec(environment="farm", seed=7))
        self.vehicle.sim.limit_speed(12.0)
        self.autopilot = DIALECTS[dialect](self.vehicle, mavlink.MAVLink(self, srcSystem=1, srcComponent=1))
        self._to_it = mavlink.MAVLink(None)

    def write(self, data):
        self.received += self._parser.parse_buffer(bytes(data)) or []

    def send(self, message):
        for parsed in self._to_it.parse_buffer(message.pack(self._link)):
            self.autopilot.handle(parsed)

    def command(self, number, *parameters):
        """Send a command; result of its acknowledgement, or None."""
        self.received.clear()
        given = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *given))
        return self.result(number)

    def result(self, number):
        return next((m.result for m in self.of("COMMAND_ACK") if m.command == number), None)

    def of(self, kind):
        return [m for m in self.received if m.get_type() == kind]

    def texts(self):
        return [m.text for m in self.of("STATUSTEXT")]

    def wait(self, seconds, until=lambda: False):
        end = self.vehicle.now_us + round(1e6 * seconds)
        while self.vehicle.now_us < end and not until():
            self.autopilot.step(self.vehicle.now_us + 20_000)

    def fly_up(self):
        assert self.command(400, 1) == MavResult.ACCEPTED and self.command(22, 0, 0, 0, NAN) == MavResult.ACCEPTED
        self.wait(20, lambda: self.autopilot.mode is FlightMode.HOLD)
        assert abs(self.vehicle.position[2] + 2.5) < 0.6
