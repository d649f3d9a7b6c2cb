"""Layouts for viewers name only topics and fields that exported files have."""

import json
import re
from functools import cache
from xml.etree import ElementTree

import numpy as np
from rosbags.typesys import Stores, get_typestore

from mavfi.config import config_root
from mavfi.extras.logs.timeline import tick_messages
from mavfi.extras.logs.ulog import FORMATS

LAYOUTS = config_root() / "layouts"


@cache
def kinds():
    return {message.topic: message.kind for message in tick_messages(np.arange(21.0))}


def displayed():
    """Topics of exported files."""
    return {"/obstacles", "/goal", "/flown", "/golden", "/path", "/trajectory", "/points", "/map", "/log", *kinds()}


def check_field(topic, path):
    """A number of the topic's ROS 2 message."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = kinds()[topic].replace("/", "/msg/")
    for name in path:
        kind = dict(store.fielddefs[kind][1])[name][1]
    assert kind[0] == "float64"


def test_foxglove():
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    panels = layout["configById"]
    assert set(re.findall(r'"((?:3D|Plot|RosOut)![a-z]+)"', json.dumps(layout["layout"]))) == set(panels)
    assert {*panels["3D!flight"]["topics"], panels["RosOut!log"]["topicToRender"]} <= displayed()
    values = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert len(values) == 9
    for value in values:
        topic, *path = value.split(".")
        check_field(topic, path)


def curves(name):
    return [curve.get("name") for curve in ElementTree.parse(LAYOUTS / name).iter("curve")]


def test_plotjuggler_with_mcap():
    for curve in curves("plotjuggler_mcap.xml"):
        _, topic, *path = curve.split("/")
        check_field(f"/{topic}", path)


def test_plotjuggler_with_ulog():
    for curve in curves("plotjuggler_ulg.xml"):
        topic, field = curve.split("/")
        name, _, index = field.partition(".")
        kinds_of_fields = dict(reversed(text.split()) for text in FORMATS[topic].rstrip(";").split(";"))
        length = re.search(r"\[(\d+)\]", kinds_of_fields[name])
        assert (int(index) < int(length[1])) if length else index == "", curve
