"""Planning as a service: `/plan` of type `nav_msgs/GetPlan`, answered on the map that the planner has at the moment."""

import threading
from typing import Any

import numpy as np

from mavfi.hosts.ros1.convert import MAP
from mavfi.hosts.ros1.mirrors import ros_type
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.planning import MotionPlanner

SERVICE = "/plan"


def find_path(planner: MotionPlanner, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """A path on the present map, without effect on the flight: the planner's randomness is restored.

    Args:
        planner: The kernel.
        start: World frame (m). Shape (3,).
        goal: Same.

    Returns:
        Vertices from start on, with the planner's radius or, if that fails, the checker's; empty = none. Shape (n, 3).
    """
    routes = planner.routes
    before = routes.search.random.copy()
    found = None
    if np.isfinite(start).all() and np.isfinite(goal).all():
        for counter in (routes.room.wide, routes.room.narrow):
            found = found if found is not None else routes.between(start, counter, goal)
    routes.search.random[:] = before
    if found is None:
        return np.zeros((0, 3))
    return found if np.array_equal(found[0], start) else np.vstack([start, found])


def offer_planning(planner: Kernel, config: PipelineConfig, lock: threading.Lock) -> None:
    """Offer the service.

    Args:
        planner: The kernel, a `MotionPlanner`.
        config: Of the mission; its goal replaces (0, 0, 0) in a request.
        lock: Held while the kernel computes.
    """
    import rospy
    from nav_msgs.srv import GetPlan, GetPlanResponse

    assert isinstance(planner, MotionPlanner)

    def answer(request: Any) -> Any:
        start, goal = (_position(pose) for pose in (request.start, request.goal))
        with lock, np.errstate(all="ignore"):
            path = find_path(planner, start, goal if goal.any() else config.goal)
        response = GetPlanResponse()
        response.plan.header.frame_id = MAP
        for vertex in path:
            pose = ros_type("geometry_msgs/PoseStamped")(header=response.plan.header)
            pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, vertex)
            pose.pose.orientation.w = 1.0
            response.plan.poses.append(pose)
        return response

    rospy.Service(SERVICE, GetPlan, answer)


def _position(pose: Any) -> np.ndarray:
    position = pose.pose.position
    return np.array([position.x, position.y, position.z])
