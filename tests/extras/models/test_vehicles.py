"""Vehicles from models: mass properties against MuJoCo, frames, rotors, what is assumed, asked for and refused."""

import math
import warnings

import mujoco
import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.extras.models import cli
from mavfi.extras.models.geometry import lump
from mavfi.extras.models.urdf import read_urdf
from mavfi.extras.models.vehicles import sdf_vehicle
from mavfi.plugins import allow_typed
from mavfi.sim.engine import GRAVITY
from mavfi.sim.mjcf import find_vehicle
from tests.extras.models import models


def written(folder, name, text):
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def imported(path):
    """The vehicle, and what was said of it."""
    with pytest.warns(UserWarning) as warned:
        config = find_vehicle(path)
    return config, str(warned[-1].message)


def refusal(path):
    with pytest.raises(BadInputError) as caught:
        find_vehicle(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("name", "text"), [("quad.sdf", models.sdf()), ("quad.urdf", models.urdf())])
def test_links_are_one_rigid_body_with_the_rotors_of_the_plugins(tmp_path, name, text):
    config, warned = imported(written(tmp_path, name, text))
    # four points of 0.05 kg, 0.1 m above the body; parallel-axis theorem by hand
    low, high = 0.2 * 0.1 / 2.2, 2.0 * 0.1 / 2.2
    around = 2.0 * low**2 + 0.2 * high**2
    expected = (0.02 + around + 0.2 * 0.2**2, 0.03 + around + 0.2 * 0.2**2, 0.04 + 0.2 * 0.08)
    assert config.name == "quad" and config.mass == pytest.approx(2.2)
    np.testing.assert_allclose(config.inertia, expected, rtol=1e-5)
    assert config.arm_length == pytest.approx(0.2 * math.sqrt(2.0), rel=1e-5)
    assert config.max_rotor_thrust == pytest.approx(models.THRUST)
    assert (config.rotor_torque_ratio, config.rotor_time_constant) == (0.02, 0.02)
    tip = math.hypot(0.2 * math.sqrt(2.0) + 0.1, high + 0.005)
    assert config.collision_radius == pytest.approx(tip, abs=1e-3) and config.collision_radius >= tip
    # Gazebo's drag: coefficient x rotor speed x speed, the same force as ours at 3 m/s
    hover = math.sqrt(2.2 * GRAVITY / 4.0 / 1e-5)
    assert config.drag == pytest.approx((4.0 * 1e-4 * hover / 3.0,) * 2 + (0.0,), rel=1e-5)
    assert "mass 2.2" in warned and "assumed" not in warned


def test_mass_properties_of_a_tree_of_turned_links_are_mujocos(tmp_path):
    joint = (
        '<joint name="{0}" type="fixed"><origin xyz="{1}" rpy="{2}"/><parent link="{3}"/><child link="{4}"/></joint>'
    )
    tree = (
        '<robot name="tree">'
        + models.urdf_link("a", 1.0, (0.01, 0.02, 0.025))
        + '<link name="b"><inertial><origin xyz="0.1 0 0.02" rpy="0.3 0.2 0.1"/><mass value="0.5"/>'
        '<inertia ixx="0.002" ixy="0.0001" ixz="0" iyy="0.003" iyz="-0.0002" izz="0.004"/></inertial></link>'
        + models.urdf_link("c", 0.2, (0.001, 0.001, 0.001))
        + joint.format("ab", "0.1 0.2 0.3", "0.4 -0.5 0.6", "a", "b")
        + joint.format("bc", "0 -0.2 0.1", "-1 0.5 0", "b", "c")
        + "</robot>"
    )
    path = written(tmp_path, "tree.urdf", tree)
    whole = lump(read_urdf(tmp_path / "tree.urdf").masses.values())
    spec = mujoco.MjSpec.from_file(path)
    spec.compiler.fusestatic = False
    spec.body("a").add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    root = model.body("a").id
    matrix = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, matrix)
    assert whole.mass == pytest.approx(model.body_subtreemass[root])
    np.testing.assert_allclose(whole.centre, data.subtree_com[root], atol=1e-12)
    # the free joint's rotations are about its origin
    arm = whole.centre
    about = whole.tensor + whole.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(matrix[3:, 3:], about, atol=1e-12)


def test_a_plus_is_flown_as_an_x_that_keeps_the_directions_of_its_rotors(tmp_path):
    config, warned = imported(written(tmp_path, "plus.sdf", models.sdf(models.PLUS)))
    assert config.arm_length == pytest.approx(0.25)
    around = 0.5 * (config.inertia[0] + config.inertia[1])
    assert config.inertia[0] == pytest.approx(around)  # 0.02 and 0.03 by halves
    assert "its front is" in warned and "mirror" not in warned and "products of inertia" in warned


def test_parts_of_other_files_and_frames_count(tmp_path):
    (tmp_path / "models" / "pod").mkdir(parents=True)
    pod = models.sdf_link("pod_link", "0.1 0 0 0 0 0", 0.4, (0.0, 0.0, 0.0), "<sphere><radius>0.02</radius></sphere>")
    written(tmp_path / "models" / "pod", "model.sdf", f'<sdf version="1.9"><model name="pod">{pod}</model></sdf>')
    frame = '<frame name="bay"><pose relative_to="base">0 0 -0.2 0 0 1.5707963</pose></frame>'
    for merge in ("true", "false"):
        include = (
            f'<include merge="{merge}"><uri>model://pod</uri><pose relative_to="bay">-0.1 0 0 0 0 0</pose></include>'
        )
        config, _ = imported(written(tmp_path, "quad.sdf", models.sdf(more=frame + include)))
        # the pod's centre is at the bay, 0.2 m below the body, as 0.1 m forward and backward cancel
        assert config.mass == pytest.approx(2.6)
        centre = (0.2 * 0.1 - 0.4 * 0.2) / 2.6
        around = 2.0 * centre**2 + 0.2 * (0.1 - centre) ** 2 + 0.4 * (0.2 + centre) ** 2
        assert config.inertia[0] == pytest.approx(0.02 + around + 0.2 * 0.04, rel=1e-5)
    gone = models.sdf(more="<include><uri>model://absent</uri></include>")
    assert "includes absent (not on this machine)" in refusal(written(tmp_path, "quad.sdf", gone))


MJCF = """<mujoco><compiler autolimits="true"/><worldbody><body name="q" pos="0 0 1" euler="0 0 90"><freejoint/>
  <geom type="box" size="0.1 0.1 0.05" mass="1"/>{sites}</body></worldbody><actuator>{motors}</actuator></mujoco>"""


def mjcf(torques):
    sites = "".join(f'<site name="s{n}" pos="{x} {y} 0.1"/>' for n, (x, y) in enumerate(models.X))
    motors = "".join(
        f'<motor name="m{n}" site="s{n}" gear="0 0 2 0 0 {torque}" ctrlrange="0 3"/>'
        for n, torque in enumerate(torques)
    )
    return MJCF.format(sites=sites, motors=motors)


def test_motors_at_sites_of_an_mjcf_model_are_rotors(tmp_path):
    config, warned = imported(written(tmp_path, "quad.xml", mjcf((-0.04, -0.04, 0.04, 0.04))))
    assert (config.mass, config.max_rotor_thrust, config.rotor_torque_ratio) == (1.0, 6.0, 0.02)
    assert config.arm_length == pytest.approx(0.2 * math.sqrt(2.0), rel=1e-5)
    assert config.collision_radius == pytest.approx(0.15) and "mirror" not in warned and "same way" not in warned
    _, warned = imported(written(tmp_path, "quad.xml", mjcf((-0.04, 0.04, 0.04, -0.04))))
    assert "its neighbouring rotors turn the same way; flown with opposite ones" in warned
    shared_motor = '<motor name="all" site="s" gear="0 0 1 0 0 0" ctrlrange="0 24"/>'
    path = written(tmp_path, "one.xml", MJCF.format(sites='<site name="s"/>', motors=shared_motor))
    assert "does not say: arm_length: " in refusal(path)
    written(tmp_path, "mine.yaml", "model: one.xml\narm_length: 0.2\n")
    assert imported(str(tmp_path / "mine.yaml"))[0].max_rotor_thrust == 6.0


CRAZYFLIE = (
    '<robot name="cf"><properties arm="0.04" kf="3e-10" km="6e-12" thrust2weight="2" drag_coeff_xy="9e-7"/>'
    + models.urdf_link("base_link", 0.03, (1.4e-5, 1.4e-5, 2.2e-5), '<cylinder radius="0.06" length="0.02"/>')
    + "".join(
        f'<link name="prop{n}_link"><inertial><origin xyz="{x} {y} 0"/><mass value="0"/></inertial></link>'
        f'<joint name="j{n}" type="fixed"><parent link="base_link"/><child link="prop{n}_link"/></joint>'
        for n, (x, y) in enumerate(((0.03, 0.03), (-0.03, 0.03), (-0.03, -0.03), (0.03, -0.03)))
    )
    + "</robot>"
)


def test_properties_of_a_crazyflie(tmp_path):
    config, warned = imported(written(tmp_path, "cf.urdf", CRAZYFLIE))
    assert config.arm_length == pytest.approx(0.03 * math.sqrt(2.0), rel=1e-5)
    assert config.max_rotor_thrust == pytest.approx(0.5 * 0.03 * GRAVITY, rel=1e-5)
    assert config.rotor_torque_ratio == pytest.approx(0.02)
    assert config.collision_radius == pytest.approx(0.061, abs=1e-3)
    assert "assumed rotor_time_constant: 0.02 s" in warned


SIH = {"SIH_MASS": 2.0, "SIH_T_MAX": 8.0, "SYS_HITL": 2, "CA_ROTOR0_CT": 6.5, "MPC_THR_HOVER": 0.5}


def test_an_airframe_asks_for_what_it_lacks_by_key_and_takes_it_from_a_yaml_file(tmp_path):
    path = written(tmp_path, "4001_small", models.AIRFRAME)
    text = refusal(path)
    assert all(f"{key}: " in text for key in ("mass", "inertia", "max_rotor_thrust")) and "arm_length" not in text
    assert "hovering at 0.5" in text and f"'model: {path}'" in text
    written(tmp_path, "mine.yaml", "model: 4001_small\nmass: 1.5\ninertia: [0.01, 0.01, 0.02]\ndrag: [0.1, 0.1, 0.2]\n")
    config, warned = imported(str(tmp_path / "mine.yaml"))
    assert config.name == "Small_Quad" and config.mass == 1.5 and config.drag == (0.1, 0.1, 0.2)
    assert config.max_rotor_thrust == pytest.approx(1.5 * GRAVITY / 4.0 / 0.5, rel=1e-5)
    assert config.rotor_torque_ratio == 0.05 and "drag" not in warned
    assert "assumed collision_radius: 1.5 x arm_length" in warned
    listed = "".join(f"1\t1\t{key}\t{value}\t9\n" for key, value in SIH.items())
    config, warned = imported(written(tmp_path, "sih.params", "# parameters\n" + listed))
    assert (config.mass, config.max_rotor_thrust) == (2.0, 8.0) and "PX4's defaults of SIH_IXX" in warned
    assert config.rate_gain == pytest.approx((9.0, 9.0, 3.0))  # for its motors of 0.05 s
    # all parameters are listed, also where PX4's own simulation is not used, and defaults say nothing
    text = refusal(written(tmp_path, "other.params", listed.replace("SYS_HITL\t2", "SYS_HITL\t0")))
    assert "mass" in text and "max_rotor_thrust: largest" in text and "hovering" not in text


def test_files_that_gazebo_reads_although_they_are_no_strict_xml(tmp_path):
    text = models.sdf().replace("<plugin ", '<gz:order a:b="1">0</gz:order><plugin ', 1)
    for before in ("\n\n", "\ufeff\n", "<!-- generated from\n a template -->\n"):
        config, _ = imported(written(tmp_path, "quad.sdf", f"{before}<?xml version='1.0'?>\n{text}"))
        assert config.mass == pytest.approx(2.2)
    for before in ("{# from a template #}\n", "{%- set mass = 2 -%}\n\n<!-- note -->\n"):
        written(tmp_path, "quad.sdf.jinja", f"{before}<?xml version='1.0'?>\n{text}")
        assert sdf_vehicle(tmp_path / "quad.sdf.jinja", {}).keys["mass"] == pytest.approx(2.2)


def test_rotors_without_collision_shapes_are_said_to_reach_out(tmp_path):
    bare = models.urdf().replace('<cylinder radius="0.1" length="0.01"/>', "<mesh filename='x.dae'/>")
    config, warned = imported(written(tmp_path, "quad.urdf", bare))
    assert config.collision_radius < config.arm_length + 0.1
    assert f"rotor tips may be outside of collision_radius ({config.collision_radius:g} m)" in warned
    written(tmp_path, "mine.yaml", "model: quad.urdf\ncollision_radius: 0.2\n")
    assert "rotor tips" not in imported(str(tmp_path / "mine.yaml"))[1]
    assert "rotor tips" not in imported(written(tmp_path, "whole.urdf", models.urdf()))[1]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("six.sdf", models.sdf((*models.X, (0.3, 0.0), (-0.3, 0.0)), (*models.SPINS, "cw", "ccw")), "6 rotors"),
        ("line.sdf", models.sdf(((0.1, 0.0), (0.2, 0.0), (0.3, 0.0), (0.4, 0.0))), "allowed: about an X or +"),
        ("motors.sdf", models.sdf(plugins=False), "does not say: max_rotor_thrust: largest thrust of one rotor (N)"),
        ("broken.sdf", "<sdf>", "not an XML file"),
        ("nan.sdf", models.sdf().replace("0.2 -0.2 0.1 0 0 0", "0.2 nan 0.1 0 0 0"), "allowed: 6 finite numbers"),
        ("macros.urdf", '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:a/></robot>', "ends in .xacro"),
        ("4002_vtol", "param set-default CA_AIRFRAME 2\n", "CA_AIRFRAME 2: allowed: 0, a multirotor"),
    ],
)
def test_what_our_vehicle_cannot_be_is_refused_with_the_reason(tmp_path, name, text, message):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert message in refusal(written(tmp_path, name, text))


def test_xacro_is_expanded_without_ros(tmp_path, monkeypatch):
    pytest.importorskip("xacro")
    ns = 'xmlns:xacro="http://ros.org/wiki/xacro"'
    (tmp_path / "parts" / "urdf").mkdir(parents=True)
    macro = '<xacro:macro name="body" params="name mass">' + models.urdf_link("${name}", "${mass}", (1, 1, 1))
    written(tmp_path / "parts" / "urdf", "body.xacro", f"<robot {ns}>{macro}</xacro:macro></robot>")
    inside = models.urdf().removeprefix('<robot name="quad">').removesuffix("</robot>")
    text = f"""<robot name="quad" {ns}><xacro:arg name="extra" default="0.25"/>
      <xacro:property name="half" value="${{0.5 * 0.4}}"/><xacro:include filename="$(find parts)/urdf/body.xacro"/>
      {inside.replace("0.2 -0.2 0.1", "${half} -${half} 0.1")}
      <xacro:body name="$(arg namespace)_box" mass="$(arg extra)"/>
      <joint name="f" type="fixed"><parent link="base"/><child link="$(arg namespace)_box"/></joint></robot>"""
    path = written(tmp_path, "quad.xacro", text)
    config, _ = imported(path)
    assert config.mass == pytest.approx(2.45)
    written(tmp_path, "mine.yaml", "model: quad.xacro\nxacro: {extra: 0.5}\n")
    assert imported(str(tmp_path / "mine.yaml"))[0].mass == pytest.approx(2.7)
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "")
    assert f"xacro file '{path}': named in a file, and so not run" in refusal(str(tmp_path / "mine.yaml"))
    allow_typed(["--vehicle", path])
    written(tmp_path, "quad.xacro", text.replace("$(find parts)", "$(find absent)"))
    assert "the package absent is not on this machine" in refusal(path)


def test_the_printed_vehicle_is_a_file_that_flies_alike(tmp_path, capsys):
    path = written(tmp_path, "quad.sdf", models.sdf(models.PLUS))
    cli.vehicle(tmp_path / "quad.sdf")
    text = capsys.readouterr().out
    assert "hovers at 67 % of the largest thrust" in text and "# flown as an X: its front is" in text
    assert "mass: 2.2 " in text and "# all links with mass (5) as one rigid body" in text
    assert find_vehicle(written(tmp_path, "same.yaml", text)) == imported(path)[0]
