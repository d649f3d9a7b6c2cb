"""Campaigns on a ROS 2 stack of the user's own: its nodes, inputs, outputs and a verdict (host `ros2_stack`).

`bench` runs trials in private namespaces: `launcher` starts the nodes, `driver` plays the inputs and records outputs,
both under the Python of the ROS 2 installation; `outputs` compares, `watching` has detectors; `host` and `sampling`
make a campaign of it.
"""
