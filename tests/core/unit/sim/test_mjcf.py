"""A user's own vehicle: what a YAML file and an MJCF model must be, and what comes of them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from mavfi.config import VehicleConfig, shipped
from mavfi.errors import BadInputError
from mavfi.sim.environments.generated import cuboids
from mavfi.sim.mjcf import find_vehicle, measure
from mavfi.sim.scene import build_model
from mavfi.sim.simulator import Simulator
from tests.core.unit.sim.flights import fly, open_world, room, scenario

COURIER = str(Path(__file__).parents[4] / "examples" / "vehicle" / "courier.yaml")
YAML = """
name: mine
mjcf: body.xml
arm_length: 0.2
collision_radius: 0.5
max_rotor_thrust: 10.0
rotor_torque_ratio: 0.01
rotor_time_constant: 0.01
drag: [0.01, 0.01, 0.1]
"""
ROD = '<geom name="rod" type="box" size="0.2 0.1 0.05" pos="0.05 0 0.02" mass="2"/>'


def xml(body, more="", before=""):
    return f"<mujoco>{before}<worldbody>{body}</worldbody>{more}</mujoco>"


def free(inside, name="mine"):
    return f'<body name="{name}"><freejoint/>{inside}</body>'


def vehicle(folder, model=None, **keys):
    if model is not None:
        (folder / "body.xml").write_text(model, encoding="utf-8")
    lines = [line for line in YAML.splitlines(keepends=True) if line.split(":")[0] not in keys]
    text = "".join([*lines, *(f"{key}: {value}\n" for key, value in keys.items())])
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    return find_vehicle(str(folder / "mine.yaml"))


def test_mass_and_inertia_of_a_box_are_those_of_the_textbook(tmp_path):
    config = vehicle(tmp_path, xml(free(ROD)))
    expected = [2 / 12 * (a**2 + b**2) for a, b in ((0.2, 0.1), (0.4, 0.1), (0.4, 0.2))]
    assert config.mass == pytest.approx(2.0)
    np.testing.assert_allclose(config.inertia, expected, rtol=1e-12)


def test_parts_are_added_about_the_common_centre_of_mass_in_the_axes_of_the_body(tmp_path):
    light, heavy = '<geom size="0.01" mass="1" pos="0.3 0 0"/>', '<geom size="0.01" mass="3"/>'
    ends = f'{light}<body pos="-0.1 0 0">{heavy}</body>'
    (tmp_path / "body.xml").write_text(xml(f'<body pos="1 2 3" euler="0 0 90"><freejoint/>{ends}</body>'), "utf-8")
    body = measure(tmp_path / "body.xml")
    inertia = 4 * 0.4 * 0.01**2
    assert body.mass == pytest.approx(4.0) and body.reach == pytest.approx(0.31)
    np.testing.assert_allclose(body.centre, 0.0, atol=1e-12)
    np.testing.assert_allclose(body.inertia, (inertia, inertia + 0.12, inertia + 0.12), rtol=1e-9)


def test_a_mesh_reaches_as_far_as_its_vertices_not_as_its_bounding_sphere(tmp_path):
    # a flat roof whose ridge is off its middle: the sphere around it reaches further than any vertex from the origin
    corners = np.array([(x, y, 0.0) for x in (-0.3, 0.3) for y in (-0.1, 0.1)] + [(0.25, 0.0, 0.2)])
    mesh = f'<asset><mesh name="m" vertex="{" ".join(map(str, corners.ravel()))}"/></asset>'
    body = free('<geom type="mesh" mesh="m" mass="0.0"/><geom size="0.01" mass="1"/>')
    (tmp_path / "body.xml").write_text(xml(body, before=mesh), "utf-8")
    assert measure(tmp_path / "body.xml").reach == pytest.approx(np.linalg.norm(corners, axis=1).max(), abs=1e-7)


def test_the_model_that_flies_has_the_centre_of_mass_at_its_origin_and_only_the_sphere_collides(tmp_path):
    odd = xml(
        free(ROD + '<site name="imu"/><geom name="collision_sphere" size="0.05" mass="0.1" pos="0 0.2 0"/>'),
        '<actuator><motor site="imu" gear="0 0 1 0 0 0"/></actuator><sensor><gyro site="imu"/></sensor>'
        '<keyframe><key qpos="0 0 0 1 0 0 0"/></keyframe>',
        '<option timestep="0.1" gravity="0 0 -1" integrator="RK4"/>',
    )
    config = vehicle(tmp_path, odd)
    world = cuboids(1, 0.05, 6.0)
    model, plain = build_model(world, config), build_model(world, shipped("vehicles", VehicleConfig, "airsim_quad"))
    assert (model.nq, model.nv, model.nu, model.nkey) == (7, 6, 0, 0)
    assert model.nsensordata == plain.nsensordata and model.opt.timestep == 0.004
    np.testing.assert_array_equal(model.opt.gravity, plain.opt.gravity)
    assert int((model.geom_contype > 0).sum()) == plain.ngeom
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.subtree_com[1], world.start, atol=1e-12)
    mass = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, mass)
    np.testing.assert_allclose(np.diag(mass), [config.mass] * 3 + list(config.inertia), rtol=1e-9)
    np.testing.assert_allclose(mass[:3, 3:], 0.0, atol=1e-12)


@pytest.mark.parametrize("world", [open_world, room])
def test_the_example_hovers_and_settles(world):
    courier = find_vehicle(COURIER)
    flight = Simulator(world(), scenario().model_copy(update={"vehicle": courier}))
    start = flight.odometry.copy()
    flight.advance(5_000_000)
    np.testing.assert_allclose(flight.odometry, start, atol=1e-9)
    if world is room:
        return
    rows = fly(flight, (3.0, 0.0, 0.5, 0.3), 5.0)
    assert rows[-1, 3] == pytest.approx(2.95, abs=0.1) and rows[:, 3].max() < 3.2
    assert rows[-1, 5] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (None, "there is no such file"),
        ("<mujoco><wings/></mujoco>", "not an MJCF file .*unrecognized element"),
        (xml('<body><geom size="0.1"/></body>'), "0 bodies with a free joint; allowed: 1"),
        (xml(free(ROD, "a") + free(ROD.replace("rod", "bar"), "b")), "2 bodies with a free joint .a, b.; allowed: 1"),
        (xml(free("")), "mass and inertia .*; allowed: a mass and an inertia above 0"),
        (
            xml(free(ROD + '<body><joint name="tilt" type="hinge"/><geom size="0.1"/></body>')),
            "joint tilt: allowed: no",
        ),
    ],
)
def test_a_model_that_does_not_fit_is_one_line_with_file_and_key(tmp_path, model, message):
    with pytest.raises(BadInputError, match=message) as caught:
        vehicle(tmp_path, model)
    assert str(caught.value).startswith(f"{tmp_path}/mine.yaml: key 'mjcf': {tmp_path}/body.xml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"mass": 2.5}, "key 'mass': 2.5: the model .*body.xml has 2; allowed: within 1 % of it, or no such key"),
        ({"inertia": "[0.0083, 0.0283, 0.035]"}, "key 'inertia': 0.035: the model .* has 0.03333; allowed"),
        (
            {"collision_radius": 0.1},
            "key 'collision_radius': 0.1: the model .* reaches 0.229 m .*; allowed: at least that",
        ),
        ({"wings": 2}, "unknown key 'wings'; allowed: name"),
    ],
)
def test_a_yaml_file_that_does_not_agree_with_its_model_is_refused(tmp_path, keys, message):
    with pytest.raises(BadInputError, match=message) as caught:
        vehicle(tmp_path, xml(free(ROD)), **keys)
    assert str(caught.value).startswith(f"{tmp_path}/mine.yaml: ")


def test_a_model_that_was_changed_since_it_was_read_is_refused(tmp_path):
    config = vehicle(tmp_path, xml(free(ROD)))
    (tmp_path / "body.xml").write_text(xml(free(ROD.replace('"2"', '"3"'))), encoding="utf-8")
    with pytest.raises(BadInputError, match="body.xml: weighs 3 kg and not 2 kg as before"):
        build_model(open_world(), config)
    (tmp_path / "body.xml").unlink()
    with pytest.raises(BadInputError, match="body.xml: there is no such file"):
        build_model(open_world(), config)


@pytest.mark.parametrize(("thrust", "lifts"), [(4.903325, False), (4.91, True)])
def test_a_vehicle_that_its_rotors_cannot_lift_is_refused(tmp_path, thrust, lifts):
    airframe = {key: value for key, value in yaml.safe_load(YAML).items() if key != "mjcf"}
    airframe |= {"mass": 2.0, "inertia": [0.01, 0.01, 0.02], "max_rotor_thrust": thrust}
    (tmp_path / "plain.yaml").write_text(yaml.safe_dump(airframe), encoding="utf-8")
    path = str(tmp_path / "plain.yaml")
    if lifts:
        assert find_vehicle(path).max_rotor_thrust == thrust
        return
    with pytest.raises(BadInputError) as error:
        find_vehicle(path)
    assert f"{path}: key 'max_rotor_thrust': {thrust:g} N: 4 such rotors do not lift 2 kg" in str(error.value)
