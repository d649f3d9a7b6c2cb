"""Runs Debian's nodelet `depth_image_proc/point_cloud_xyz`: depth image to point cloud, in C++.

Debian's library package `libdepth-image-proc0d` contains the code, but not the files by which `pluginlib` finds it:
those are in the development package, which depends on 200 others.  They are a few lines, generated here.
"""

from collections.abc import Mapping
from pathlib import Path

from mavfi.errors import BadInputError
from mavfi.hosts.ros1.finder import environment, find_file

NODELET = "usr/lib/nodelet/nodelet"
PACKAGES = ("libnodeletlib-tools", "libdepth-image-proc0d")
_LIBRARY = "usr/lib/x86_64-linux-gnu/libdepth_image_proc.so.0d"
_PLUGINS = """<library path="lib/libdepth_image_proc">
  <class name="depth_image_proc/point_cloud_xyz" type="depth_image_proc::PointCloudXyzNodelet"
         base_class_type="nodelet::Nodelet">
    <description>Converts a depth image to a cloud of points.</description>
  </class>
</library>
"""
_PACKAGE = """<package format="2"><name>depth_image_proc</name><version>1.17.0</version>
<description>Found.</description>
<maintainer email="mavfi@localhost">mavfi</maintainer><license>BSD</license><depend>nodelet</depend>
<export><nodelet plugin="${prefix}/nodelet_plugins.xml"/></export></package>
"""


def require() -> None:
    """Check that it is installed; the `BadInputError` names the remedy."""
    for name in (NODELET, _LIBRARY):
        if not find_file(name).exists():
            raise BadInputError(
                f"depth_image_proc: /{name} is missing: install the Debian packages {' and '.join(PACKAGES)}"
            )


def point_cloud_xyz(folder: Path, remappings: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Command and environment variables to run the nodelet; its `pluginlib` files are written to a folder.

    `remappings`: of its topics `image_rect`, `camera_info` and `points`, and of `__name`.
    """
    require()
    share = folder / "share" / "depth_image_proc"
    share.mkdir(parents=True, exist_ok=True)
    (share / "nodelet_plugins.xml").write_text(_PLUGINS)
    (share / "package.xml").write_text(_PACKAGE)
    library = folder / "lib" / "libdepth_image_proc.so"
    library.parent.mkdir(exist_ok=True)
    if not library.is_symlink():
        library.symlink_to(find_file(_LIBRARY))
    (folder / ".catkin").touch()
    command = [str(find_file(NODELET)), "standalone", "depth_image_proc/point_cloud_xyz"]
    given = environment()
    command += [f"{name}:={value}" for name, value in remappings.items()]
    return command, {
        "CMAKE_PREFIX_PATH": f"{folder}:{given.get('CMAKE_PREFIX_PATH', '/usr')}",
        "ROS_PACKAGE_PATH": f"{given['ROS_PACKAGE_PATH']}:{folder / 'share'}",
    }
