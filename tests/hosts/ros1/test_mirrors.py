"""Mirrors in standard types say the same as the states, in the frames of REP-103 and REP-105."""

import io

import numpy as np
import pytest

from mavfi.config import CameraConfig
from mavfi.faults.sensor.fault import SensorFault
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.ros1 import mirrors
from mavfi.hosts.ros1.convert import from_stamp
from mavfi.numerics.rotations import rotation_matrix
from mavfi.pipeline.perception import PointCloud
from mavfi.states import floats, new_state
from tests.hosts.missions import golden, mission
from tests.hosts.ros1.needs import ros

pytestmark = [*ros, pytest.mark.usefixtures("messages")]
CAMERA = CameraConfig()
TOPICS = {standard.topic: standard for standard in mirrors.STANDARDS}


def message(topic, state, time_us=1_500_000):
    """The mirror of a state, after a way over the wire."""
    sent = TOPICS[topic].message(state, time_us, CAMERA)
    wire = io.BytesIO()
    sent.serialize(wire)
    return type(sent)().deserialize(wire.getvalue())


def matrix(wxyz):
    rotation = np.empty((3, 3))
    rotation_matrix(np.array(wxyz, float), rotation)
    return rotation


def odometry():
    state = new_state("sensor.odometry")
    values = floats(state.header, 13)
    values[:6] = (1.0, -2.0, 3.0, 0.5, 2.0, -0.25)
    turn = np.array([0.8, 0.1, -0.2, 0.5])
    values[6:10] = turn / np.linalg.norm(turn)
    values[10:13] = (0.1, 0.2, 0.3)
    return state


def xyz(thing):
    return np.array([thing.x, thing.y, thing.z])


def wxyz(thing):
    return np.array([thing.w, thing.x, thing.y, thing.z])


def test_the_depth_image_gives_the_point_cloud_back():
    """Pixel by pixel, by the camera matrix, the optical frame and the pose: what kernel `point_cloud` computes."""
    from mavfi.hosts.ros1.session import configure

    state = new_state("sensor.depth", CAMERA.width * CAMERA.height)
    state.elements["range"] = np.random.default_rng(1).uniform(1.0, 15.0, len(state.elements))
    floats(state.header, 7)[:] = floats(odometry().header, 13)[[0, 1, 2, 6, 7, 8, 9]]
    image, info = message("/camera/depth/image_rect", state), message("/camera/depth/camera_info", state)
    assert (image.encoding, image.header.frame_id) == ("32FC1", info.header.frame_id)
    depth = np.frombuffer(image.data, np.float32).reshape(image.height, image.width).astype(float)
    rows, columns = np.mgrid[: image.height, : image.width]
    focal, cx, cy = info.K[0], info.K[2], info.K[5]
    optical = np.stack([(columns - cx) / focal * depth, (rows - cy) / focal * depth, depth], -1).reshape(-1, 3)
    pose = floats(state.header, 7)
    expected = optical @ matrix(mirrors.TO_OPTICAL).T @ matrix(pose[3:7]).T + pose[:3]
    kernel = PointCloud(configure(mission()))
    kernel.receive(state, 0)
    (cloud,) = kernel.step(0)
    points = np.stack([cloud.elements[axis] for axis in "xyz"], -1)
    assert np.abs(points - expected).max() < 1e-4
    mirrored = message("/points", cloud)
    assert np.array_equal(np.frombuffer(mirrored.data, np.float32).reshape(-1, 3), points)
    assert (mirrored.header.frame_id, [field.name for field in mirrored.fields]) == ("map", ["x", "y", "z"])
    assert mirrored.point_step * mirrored.width == len(mirrored.data)


def test_odometry_and_transform_agree():
    state = odometry()
    values = floats(state.header, 13)
    came, tf = message("/odometry", state), message("/tf", state).transforms[0]
    assert (
        (came.header.frame_id, came.child_frame_id) == (tf.header.frame_id, tf.child_frame_id) == ("map", "base_link")
    )
    assert from_stamp(came.header.stamp) == from_stamp(tf.header.stamp) == 1_500_000
    for position, turn in (
        (came.pose.pose.position, came.pose.pose.orientation), (tf.transform.translation, tf.transform.rotation),
    ):  # fmt: skip
        assert np.array_equal(xyz(position), values[:3])
        assert np.array_equal(wxyz(turn), values[6:10])
    # REP-105: the twist is in the child frame
    assert np.allclose(matrix(values[6:10]) @ xyz(came.twist.twist.linear), values[3:6], atol=1e-12)


def test_a_trajectory_is_published_with_its_times():
    state = new_state("planning.trajectory", 3)
    points = floats(state.elements, 11).reshape(-1, 11)
    points[:] = np.arange(33).reshape(3, 11) / 10
    points[:, 10] = 0.5
    came = message("/trajectory", state)
    assert [point.time_from_start.to_sec() for point in came.points] == [0.0, 0.5, 1.0]
    assert np.array_equal(xyz(came.points[2].transforms[0].translation), points[2, :3])
    assert np.array_equal(xyz(came.points[2].velocities[0].linear), points[2, 4:7])
    yaw = 2 * np.arctan2(came.points[1].transforms[0].rotation.z, came.points[1].transforms[0].rotation.w)
    assert yaw == pytest.approx(points[1, 3])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_corrupted_values_are_mirrored_without_a_failure(value):
    trajectory, waypoint = new_state("planning.trajectory", 2), new_state("planning.waypoint")
    floats(trajectory.elements, 11).reshape(-1, 11)[:] = value
    floats(waypoint.header, 11)[:] = value
    message("/trajectory", trajectory)
    assert np.array_equal(xyz(message("/reference", waypoint).points[0].transforms[0].translation), [value] * 3, True)


def test_commands_and_paths():
    command, path = new_state("control.command"), new_state("planning.path", 2)
    floats(command.header, 4)[:] = (1.0, 2.0, 3.0, 0.4)
    floats(path.elements, 3)[:] = [[1, 2, 3], [4, 5, 6]]
    twist = message("/command", command).twist
    assert (*xyz(twist.linear), twist.angular.z) == (1.0, 2.0, 3.0, 0.4)
    assert [tuple(xyz(pose.pose.position)) for pose in message("/path", path).poses] == [(1, 2, 3), (4, 5, 6)]


def test_the_imu_is_published_in_the_body_frame():
    came = mirrors.imu_message(np.arange(6.0), 20_000)
    assert came.header.frame_id == "base_link" and came.orientation_covariance[0] == -1.0
    assert tuple(xyz(came.linear_acceleration)) == (0.0, 1.0, 2.0)
    assert tuple(xyz(came.angular_velocity)) == (3.0, 4.0, 5.0)


def test_the_camera_looks_ahead():
    transform = mirrors.camera_transform().transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "camera_optical")
    # z of the optical frame is ahead, x to the right, y down
    assert np.allclose(matrix(wxyz(transform.transform.rotation)), [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def test_planning_as_a_service_leaves_the_planner_as_it_was():
    from mavfi.hosts.ros1.kernels import find_path

    planner = golden("published").pipeline["planner"]
    goal = planner.routes._config.goal
    before = planner.routes.search.random.copy()
    start = goal - np.array([8.0, 0.0, 0.0])
    path = find_path(planner, start, goal)
    assert len(path) >= 2
    assert np.array_equal(path[0], start)
    assert np.linalg.norm(path[-1] - goal) < 3.1
    assert np.array_equal(planner.routes.search.random, before)
    assert len(find_path(planner, np.full(3, np.nan), goal)) == 0


@pytest.mark.parametrize(("failure", "changed"), [(None, False), (SensorFault("gyro", "wrong"), True)])
def test_the_mirror_of_the_imu_fails_with_its_gyro(monkeypatch, failure, changed):
    class Topic(list):
        def publish(self, sent):
            self.append(sent)

        def get_num_connections(self):
            return 1

    topics = {}
    monkeypatch.setattr(mirrors, "_publisher", lambda name, *_, **__: topics.setdefault(name, Topic()))
    mirrors.Senses(new_loop(mission()).plant, False, failure).publish(20_000)
    rates = xyz(topics["/imu/data"][0].angular_velocity)
    assert (rates != new_loop(mission()).plant.imu()[3:]).any() == changed
