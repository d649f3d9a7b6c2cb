"""A node of a flight, in a process that the supervisor has forked."""

import os
import signal
import traceback
import warnings
from typing import NoReturn

from mavfi.extras.ros.ros1.folder import FAILURE, flight_folder
from mavfi.extras.ros.ros1.graph import DETECTOR, INJECTOR, WORLD
from mavfi.extras.ros.ros1.plan import Plan


def main(name: str, plan: Plan) -> NoReturn:
    """Run a node until the supervisor ends it; an exception ends it at once, and in the world's node the flight."""
    try:
        import rospy

        # values are published without a queue: the order of transmission is that of the calls
        warnings.filterwarnings("ignore", "The publisher should be created", SyntaxWarning)
        rospy.init_node(name, argv=[], disable_signals=True, disable_rostime=True, disable_rosout=True)
        _run(name, plan)
        signal.pause()
    except BaseException:
        traceback.print_exc()
        if name == WORLD:
            (flight_folder() / FAILURE).write_text(traceback.format_exc())
    os._exit(1)


def _run(name: str, plan: Plan) -> None:
    if name == WORLD:
        from mavfi.extras.ros.ros1.world import fly

        fly(plan)
    elif name == INJECTOR:
        from mavfi.extras.ros.ros1.taps import InjectorNode

        InjectorNode(plan).run()
    elif name == DETECTOR:
        from mavfi.extras.ros.ros1.taps import DetectorNode

        DetectorNode(plan).run()
    else:
        from mavfi.extras.ros.ros1.kernels import KernelNode

        KernelNode(name, plan).run()
