"""Worlds from other simulators: their shapes as boxes, against MuJoCo's distances; poses, planes, missions."""

import json
import math

import mujoco
import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.models import aerialist, worlds
from mavfi.extras.models.boxes import FINEST_CELL, boxes_of
from mavfi.extras.models.geometry import BOX, CAPSULE, CYLINDER, SPHERE, Pose, Shape, matrix_of_rpy

START, GOAL = (0.0, 0.0, 2.0), (20.0, 0.0, 2.0)


def inside(shape, points):
    """Whether points are inside a shape, by its definition."""
    local = (points - shape.pose.position) @ shape.pose.matrix
    x, y, z = local.T
    if shape.kind == BOX:
        return (np.abs(local) <= 0.5 * np.array(shape.size)).all(axis=1)
    if shape.kind == CYLINDER:
        return (np.hypot(x, y) <= shape.size[0]) & (np.abs(z) <= 0.5 * shape.size[1])
    if shape.kind == CAPSULE:
        beyond = np.maximum(np.abs(z) - 0.5 * shape.size[1], 0.0)
        return np.sqrt(x**2 + y**2 + beyond**2) <= shape.size[0]
    size = shape.size * 3 if shape.kind == SPHERE else shape.size
    return np.square(local / np.array(size)).sum(axis=1) <= 1.0


def test_a_box_along_the_axes_stays_one_box_also_lying_on_its_side():
    for rpy in (
        (0.0, 0.0, 0.0),
        (math.pi / 2, 0.0, 0.0),
        (0.0, math.pi / 2, math.pi / 2),
        (math.pi, 0.0, -math.pi / 2),
    ):
        matrix = matrix_of_rpy(*rpy)
        boxes = boxes_of([Shape(BOX, (1.0, 2.0, 3.0), Pose(matrix, np.array([5.0, 0.0, 1.0])), "it")])
        half = 0.5 * np.abs(matrix @ [1.0, 2.0, 3.0])
        np.testing.assert_allclose(boxes.lower, [[5.0, 0.0, 1.0] - half], atol=1e-9)
        np.testing.assert_allclose(boxes.upper, [[5.0, 0.0, 1.0] + half], atol=1e-9)
        assert boxes.cell == 0.0


def sdf_box(name, pose, size, more="<static>true</static>"):
    return f"""<model name="{name}"><pose>{pose}</pose>{more}<link name="l"><pose>0 0 0.5 0 0 0</pose>
      <collision name="c"><geometry><box><size>{size}</size></box></geometry></collision></link></model>"""


GROUND = """<model name="floor"><static>true</static><link name="l"><collision name="c"><geometry><plane>
  <normal>0 0 1</normal></plane></geometry></collision></link></model>"""


def sdf_file(folder, *models):
    (folder / "walls.sdf").write_text(f'<sdf version="1.6"><world name="w">{"".join(models)}</world></sdf>', "utf-8")
    return str(folder / "walls.sdf")


def test_a_world_of_boxes_with_nested_and_included_models(tmp_path):
    (tmp_path / "crate").mkdir()
    inner = sdf_box("inner", "0 0 1 0 0 1.5707963267948966", "2 1 1")
    crate = f'<sdf version="1.6"><model name="crate"><static>1</static><pose>9 9 9 0 0 0</pose>{inner}</model></sdf>'
    (tmp_path / "crate" / "model.sdf").write_text(crate, encoding="utf-8")
    include = "<include><uri>model://crate</uri><pose>7 0 0 0 0 0</pose></include>"
    path = sdf_file(
        tmp_path, GROUND, "<include><uri>model://sun</uri></include>", sdf_box("a", "10 1 0 0 0 0", "1 4 3"), include
    )
    with pytest.warns(UserWarning, match="walls.sdf: obstacles: 2$"):
        environment = worlds.sdf_environment(tmp_path / "walls.sdf")
    assert (environment.generator, environment.parameters) == ("sdf_world", {"path": path})
    world = worlds.sdf_world(0, path, START, GOAL)
    np.testing.assert_allclose(world.lower, [(9.5, -1.0, -1.0), (6.5, -1.0, 1.0)], atol=1e-9)
    np.testing.assert_allclose(world.upper, [(10.5, 3.0, 2.0), (7.5, 1.0, 2.0)], atol=1e-9)
    assert (world.flight_lower <= START).all() and (world.flight_upper >= GOAL).all()
    assert len(worlds.sdf_world(0, path, START, GOAL, without=["crate"]).lower) == 1


def test_a_saved_world_has_its_models_where_they_were_when_it_was_saved(tmp_path):
    state = '<state world_name="w"><model name="a"><pose>5 6 0 0 0 1.5707963267948966</pose></model></state>'
    path = sdf_file(tmp_path, sdf_box("a", "10 1 0 0 0 0", "1 4 2"), state)
    world = worlds.sdf_world(0, path, START, GOAL)
    np.testing.assert_allclose((world.lower, world.upper), ([(3, 5.5, -0.5)], [(7, 6.5, 1.5)]), atol=1e-9)


def test_what_is_no_box_or_not_there_is_named_and_can_be_left_out(tmp_path):
    mesh = sdf_box("tree", "5 5 0 0 0 0", "1 1 1").replace("<box><size>1 1 1</size></box>", "<mesh><uri>a</uri></mesh>")
    path = sdf_file(tmp_path, mesh, "<include><uri>model://shed</uri></include>", sdf_box("a", "9 0 0 0 0 0", "1 1 1"))
    with pytest.raises(BadInputError) as caught:
        worlds.sdf_world(0, path, START, GOAL)
    text = str(caught.value)
    assert "tree::l (mesh), shed (not on this machine); allowed: without them" in text and "sdf_world" in text
    world = worlds.sdf_world(0, path, START, GOAL, without=["*(mesh)", "shed"])
    assert len(world.lower) == 1
    with pytest.raises(BadInputError, match="has no start and goal of its own; give both"):
        worlds.sdf_world(0, path)


VISUAL_WALL = sdf_box("wall", "4 0 1.5 0 0 0", "0.3 8 4").replace("collision", "visual")
FLOOR_TO_SEE = GROUND.replace("collision", "visual").replace("floor", "carpet")


def test_what_is_only_to_look_at_is_named_and_can_be_an_obstacle(tmp_path):
    path = sdf_file(tmp_path, VISUAL_WALL, FLOOR_TO_SEE, sdf_box("pillar", "6 3 1.5 0 0 0", "1 1 4"))
    with pytest.warns(UserWarning, match=r"obstacles: 1; only to look at, and flown through: wall \(.*visual: true"):
        worlds.sdf_environment(tmp_path / "walls.sdf")
    assert len(worlds.sdf_world(0, path, START, GOAL).lower) == 1
    world = worlds.sdf_world(0, path, START, GOAL, visual=True)
    np.testing.assert_allclose(world.lower, [(5.5, 2.5, 0.0), (3.85, -4.0, 0.0)], atol=1e-9)
    with pytest.raises(BadInputError, match="parameter 'visual': 1; allowed: true, false"):
        worlds.sdf_world(0, path, START, GOAL, visual=1)


def test_geoms_to_look_at_count_unless_their_body_has_others_that_collide(tmp_path):
    no_contact = 'contype="0" conaffinity="0"'
    (tmp_path / "scene.xml").write_text(
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1" {no_contact}/>
        <body name="wall" pos="4 0 2"><geom type="box" size="0.15 4 2" {no_contact}/></body>
        <body name="crate" pos="9 0 2"><geom type="box" size="1 1 1"/><geom type="sphere" size="1" {no_contact}/></body>
        </worldbody></mujoco>""",
        encoding="utf-8",
    )
    with pytest.warns(UserWarning, match=r"obstacles: 1; only to look at, and flown through: wall \("):
        worlds.xml_environment(tmp_path / "scene.xml")
    assert len(worlds.mjcf_world(0, str(tmp_path / "scene.xml"), START, GOAL).lower) == 1
    assert len(worlds.mjcf_world(0, str(tmp_path / "scene.xml"), START, GOAL, visual=True).lower) == 2


SCENE = """<mujoco><compiler angle="degree"/><worldbody>
  <geom type="plane" size="50 50 1"/>
  <body pos="6 1 1" euler="0 0 30"><geom type="box" size="0.2 2 1"/></body>
  <body pos="9 -1 1.2" euler="20 10 40"><geom name="beam" type="box" size="0.3 1.5 0.2"/></body>
  <geom type="cylinder" size="0.5 1" pos="12 2 1"/>
  <geom type="plane" size="5 5 1" pos="0 -15 0" xyaxes="1 0 0 0 0 -1"/>
  <geom type="box" size="1 1 1" pos="3 3 3" contype="0" conaffinity="0"/>
  <body name="quad" pos="0 0 1"><freejoint/><geom size="0.1" mass="1"/></body>
</worldbody></mujoco>"""


def test_distances_in_a_scene_are_mujocos_within_the_width_of_a_cell(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE, encoding="utf-8")
    with pytest.warns(UserWarning, match="obstacles: 3, as .*; those that are not along the axes are up to 0.05 m"):
        worlds.xml_environment(path)
    world = worlds.mjcf_world(0, str(path), START, GOAL)
    spec = mujoco.MjSpec.from_file(str(path))
    probe = spec.worldbody.add_body(name="probe")
    probe.add_freejoint()
    probe.add_geom(name="probe", size=[0.01, 0.0, 0.0])
    model = spec.compile()
    data = mujoco.MjData(model)
    fixed = [geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]] == 0]
    fixed = [geom for geom in fixed if model.geom_contype[geom]]
    probe_id = model.geom("probe").id
    random = np.random.default_rng(2)
    points = random.uniform((3.0, -14.0, 0.1), (15.0, 5.0, 3.0), (80, 3))
    ours = world.clearance(points)
    for point, distance in zip(points, ours, strict=True):
        data.qpos[-7:] = (*point, 1.0, 0.0, 0.0, 0.0)
        mujoco.mj_forward(model, data)
        theirs = min(0.01 + mujoco.mj_geomDistance(model, data, geom, probe_id, 20.0, None) for geom in fixed)
        assert distance <= max(theirs, 0.0) + 1e-6
        assert distance >= theirs - math.sqrt(2.0) * FINEST_CELL - 0.02  # a polygon around the cylinder


def test_the_box_of_a_test_case_turns_from_north_to_east(tmp_path):
    case = """robot: {mission_file: flights/there.plan}
simulation:
  obstacles:
  - {size: {l: 10, w: 1, h: 5}, position: {x: 20, y: 3, z: 0, r: 0}}
  - {size: {l: 10, w: 1, h: 5}, position: {x: 30, y: 3, z: 0, r: 90}}
  - {shape: cylinder, size: {l: 0, w: 0, h: 4, r: 1}, position: {x: 40, y: -5, z: 1, r: 0}}
  - {size: {l: 10, w: 1, h: 5}, position: {x: 50, y: 0, z: 0, r: 30}}
"""
    (tmp_path / "case.yaml").write_text(case, encoding="utf-8")
    (tmp_path / "flights").mkdir()

    def item(command, north, east, height):
        latitude = 47.0 + math.degrees(north / 6371000.0)
        longitude = 8.0 + math.degrees(east / 6371000.0 / math.cos(math.radians(47.0)))
        return {"command": command, "params": [0, 0, 0, None, latitude, longitude, height], "type": "SimpleItem"}

    items = [item(22, 0, 0, 3.0), item(16, 30, 0, 4.0), {"command": 178, "params": [0] * 7}, item(21, 60, 10, 0.0)]
    plan = {"mission": {"items": items, "plannedHomePosition": [47.0, 8.0, 488.0]}}
    (tmp_path / "flights" / "there.plan").write_text(json.dumps(plan), encoding="utf-8")
    path = str(tmp_path / "case.yaml")
    with pytest.warns(UserWarning, match="obstacles: 4, as .*; flown from above home to the last way-point; 2 between"):
        environment = aerialist.yaml_environment(tmp_path / "case.yaml")
    assert environment.generator == "aerialist_test"
    world = aerialist.aerialist_test(0, path)
    np.testing.assert_allclose((world.start, world.goal), ((0.0, 0.0, 3.0), (10.0, 60.0, 4.0)), atol=1e-3)
    np.testing.assert_allclose(world.lower[0], (2.5, 15.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(world.upper[0], (3.5, 25.0, 5.0), atol=1e-9)
    np.testing.assert_allclose((world.lower[1], world.upper[1]), ((-2, 29.5, 0), (8, 30.5, 5)), atol=1e-9)
    assert world.clearance(np.array([-5.0, 40.0, 0.5])) == pytest.approx(0.5, abs=1e-9)  # below the cylinder
    # 30 degrees from north to east: its northern end is in the east
    end = np.array([[5.2 * math.sin(math.pi / 6), 50.0 + 5.2 * math.cos(math.pi / 6), 2.0]])
    assert world.clearance(end)[0] < 0.3 and world.clearance(end * [-1, 1, 1])[0] > 1.9
    alone = aerialist.aerialist_test(0, str(tmp_path / "flights" / "there.plan"))
    assert not len(alone.lower) and alone.course == pytest.approx(world.course)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("simulation: {obstacles: [1, 2]}", "2 numbers: allowed: l w h x y z r"),
        ("simulation: {obstacles: [[0, 1, 1, 0, 0, 0, 0]]}", "sizes above 0"),
        ("simulation: {obstacles: {}}", "allowed: a list"),
        ("robot: {mission_file: gone.plan}", "key 'mission_file': gone.plan: there is no such file"),
        ("simulation: {obstacles: [5, 5, 5, 10, 5, 0, 0]}", "names no mission"),
    ],
)
def test_test_cases_that_cannot_be_flown_are_refused(tmp_path, text, message):
    (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(BadInputError, match=message):
        aerialist.aerialist_test(0, str(tmp_path / "case.yaml"))


def test_our_own_environment_files_are_left_alone(tmp_path):
    (tmp_path / "mine.yaml").write_text("name: mine\ngenerator: cuboids\n", encoding="utf-8")
    assert aerialist.yaml_environment(tmp_path / "mine.yaml") is None
