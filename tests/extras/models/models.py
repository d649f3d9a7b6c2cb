"""Small models of quadrotors in the formats of other simulators, as text."""

X = ((0.2, -0.2), (-0.2, 0.2), (0.2, 0.2), (-0.2, -0.2))
PLUS = ((0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
SPINS = ("ccw", "ccw", "cw", "cw")
THRUST = 1e-5 * 900.0**2
"""Largest thrust of a rotor (N)."""


def motor(n, spin, constant=1e-5):
    return f"""<plugin name="motor{n}" filename="libmotor.so"><jointName>joint_{n}</jointName>
      <linkName>rotor_{n}</linkName><turningDirection>{spin}</turningDirection>
      <timeConstantUp>0.01</timeConstantUp><timeConstantDown>0.03</timeConstantDown>
      <maxRotVelocity>900</maxRotVelocity><motorConstant>{constant}</motorConstant>
      <momentConstant>0.02</momentConstant><rotorDragCoefficient>1e-4</rotorDragCoefficient></plugin>"""


def sdf_link(name, pose, mass, inertia, shape):
    xx, yy, zz = inertia
    return f"""<link name="{name}"><pose>{pose}</pose><inertial><mass>{mass}</mass><inertia>
      <ixx>{xx}</ixx><iyy>{yy}</iyy><izz>{zz}</izz></inertia></inertial>
      <collision name="c"><geometry>{shape}</geometry></collision></link>"""


def sdf(rotors=X, spins=SPINS, more="", plugins=True):
    """A body of 2 kg and rotors of 0.05 kg, 0.1 m above it."""
    body = sdf_link("base", "0 0 0 0 0 0", 2.0, (0.02, 0.03, 0.04), "<box><size>0.4 0.4 0.1</size></box>")
    for n, ((x, y), spin) in enumerate(zip(rotors, spins, strict=True)):
        disc = "<cylinder><radius>0.1</radius><length>0.01</length></cylinder>"
        body += sdf_link(f"rotor_{n}", f"{x} {y} 0.1 0 0 0", 0.05, (0.0, 0.0, 0.0), disc)
        body += f'<joint name="joint_{n}" type="revolute"><parent>base</parent><child>rotor_{n}</child></joint>'
        if plugins:
            body += motor(n, spin)
    return f'<sdf version="1.9"><model name="quad"><pose>0 0 1 0 0 0.5</pose>{body}{more}</model></sdf>'


def urdf_link(name, mass, inertia, shape=""):
    xx, yy, zz = inertia
    if shape:
        shape = f"<collision><geometry>{shape}</geometry></collision>"
    return f"""<link name="{name}"><inertial><mass value="{mass}"/>
      <inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>{shape}</link>"""


def urdf(rotors=X, spins=SPINS):
    """The same vehicle."""
    body = urdf_link("base", 2.0, (0.02, 0.03, 0.04), '<box size="0.4 0.4 0.1"/>')
    for n, ((x, y), spin) in enumerate(zip(rotors, spins, strict=True)):
        body += urdf_link(f"rotor_{n}", 0.05, (0.0, 0.0, 0.0), '<cylinder radius="0.1" length="0.01"/>')
        body += f"""<joint name="joint_{n}" type="continuous"><origin xyz="{x} {y} 0.1"/><parent link="base"/>
          <child link="rotor_{n}"/></joint><gazebo>{motor(n, spin)}</gazebo>"""
    return f'<robot name="quad">{body}</robot>'


AIRFRAME = """#!/bin/sh
# @name Small Quad
. ${R}etc/init.d/rc.mc_defaults
param set-default CA_ROTOR_COUNT 4
param set-default CA_ROTOR0_PX 0.2
param set-default CA_ROTOR0_PY 0.2
param set-default CA_ROTOR1_PX -0.2
param set-default CA_ROTOR1_PY -0.2
param set-default CA_ROTOR2_PX 0.2
param set-default CA_ROTOR2_PY -0.2
param set-default CA_ROTOR2_KM -0.05
param set-default CA_ROTOR3_PX -0.2
param set-default CA_ROTOR3_PY 0.2
param set-default CA_ROTOR3_KM -0.05
param set-default MPC_THR_HOVER 0.5
"""
