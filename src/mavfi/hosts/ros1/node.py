"""Entry point of a node: `python -m mavfi.hosts.ros1.node NAME`, started by roslaunch."""

import signal
import sys
import traceback
import warnings

from mavfi.hosts.ros1 import finder
from mavfi.hosts.ros1.folder import FAILURE, MESSAGES, flight_folder
from mavfi.hosts.ros1.graph import DETECTOR, INJECTOR, WORLD
from mavfi.hosts.ros1.plan import Plan, load_plan
from mavfi.hosts.ros1.ports import die
from mavfi.hosts.ros1.processes import end_with_parent


def main(plan: Plan | None = None) -> None:
    """Run the node named on the command line, with the given plan or the saved one, until shutdown."""
    end_with_parent()  # no node outlives its roslaunch
    finder.enable(flight_folder() / MESSAGES)
    import rospy

    name = rospy.myargv(sys.argv)[1]
    plan = plan or load_plan()
    warnings.filterwarnings("ignore", "The publisher should be created", SyntaxWarning)  # intentionally unqueued
    rospy.init_node(name, disable_signals=True, disable_rostime=True, disable_rosout=True)
    try:
        run(name, plan)
    except BaseException:
        if name != WORLD:
            die()
        (flight_folder() / FAILURE).write_text(traceback.format_exc())
    signal.pause()  # the supervisor terminates all nodes together


def run(name: str, plan: Plan) -> None:
    """Run a node by name."""
    if name == WORLD:
        from mavfi.hosts.ros1.world import fly

        fly(plan)
    elif name in plan.graph.nodes:
        from mavfi.hosts.ros1.kernels import FreeNode, LockStepNode

        (FreeNode if plan.free_running else LockStepNode)(name, plan).run()
    elif name == INJECTOR:
        from mavfi.hosts.ros1.taps import Injector

        Injector(plan).run()
    elif name == DETECTOR:
        from mavfi.hosts.ros1.taps import Watcher

        Watcher(plan).run()


if __name__ == "__main__":
    main()
