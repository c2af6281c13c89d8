"""The messages as text: `.msg` files, schemas for a log, and the page of reference."""

from collections.abc import Iterator

from testbed.core.records import messages  # noqa: F401  (fills MESSAGES)
from testbed.core.records.definition import MESSAGES, OURS, SCALARS, Definition

LINE = "=" * 80
MADE = "# made from core/records/messages.py by `python -m testbed.core.records`\n"

PACKAGE_XML = f"""<?xml version="1.0"?>
<package format="3">
  <name>{OURS}</name>
  <version>0.1.0</version>
  <description>Messages of a testbed of planar air-bearing satellite simulators</description>
  <maintainer email="testbed@localhost">the testbed's developers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def type_name(name: str) -> str:
    """Full name of a type in a field or schema, like `testbed_msgs/Pose`."""
    return name if "/" in name or name in SCALARS or name == "string" else f"{OURS}/{name}"


def ros_name(name: str) -> str:
    """Name of a type in ROS 2, like `testbed_msgs/msg/Pose`."""
    return type_name(name).replace("/", "/msg/")


def constants(definition: Definition) -> Iterator[tuple[str, str, int]]:
    """Constants of a message: type, name, value."""
    for field, codes in definition.codes.items():
        kind = next(one.kind for one in definition.fields if one.name == field)
        for code in codes:
            yield kind, f"{field.upper()}_{code.name}", code.value


def msg_text(definition: Definition) -> str:
    """The text of a `.msg` file."""
    lines = [f"# {definition.meaning}", ""] if definition.meaning else []
    lines += [f"{kind} {name}={value}" for kind, name, value in constants(definition)]
    for one in definition.fields:
        text = one.type_text.replace(one.kind, type_name(one.kind), 1)
        lines.append(f"{text} {one.name}" + (f"  # {one.meaning}" if one.meaning else ""))
    return "\n".join(lines) + "\n"


def schema_text(name: str) -> str:
    """The definition of a message and of all messages in it, as in an MCAP file (`ros2msg`)."""
    names = list(dict.fromkeys(_inside(name)))
    texts = [msg_text(MESSAGES[name])]
    texts += [f"MSG: {type_name(one)}\n{msg_text(MESSAGES[one])}" for one in names if one != name]
    return f"{LINE}\n".join(texts)


def _inside(name: str) -> Iterator[str]:
    yield name
    for one in MESSAGES[name].fields:
        if one.kind in MESSAGES:
            yield from _inside(one.kind)


def package() -> dict[str, str]:
    """Files of the ROS 2 package of our messages, by path."""
    ours = [one for one in MESSAGES.values() if "/" not in one.name]
    files = {f"msg/{one.name}.msg": MADE + msg_text(one) for one in ours}
    listed = "\n".join(f'  "{path}"' for path in sorted(files))
    cmake = f"""cmake_minimum_required(VERSION 3.8)
project({OURS})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
    return files | {"package.xml": PACKAGE_XML, "CMakeLists.txt": cmake}


def page() -> str:
    """The page of reference, in Markdown."""
    lines = ["# Messages", "", *PAGE_INTRO]
    for one in MESSAGES.values():
        if "/" in one.name:
            continue
        lines += ["", f"## {one.name}", "", one.meaning, "", "| field | type | meaning |"]
        lines += ["|---|---|---|"]
        for field in one.fields:
            if field.name != "reserved":
                cells = f"`{field.name}`", f"`{field.type_text}`", field.meaning
                lines.append(f"| {' | '.join(cells)} |")
        for name, codes in one.codes.items():
            listed = ", ".join(f"{code.value} `{code.name}`" for code in codes)
            lines += ["", f"`{name}`: {listed}"]
    return "\n".join(lines) + "\n"


PAGE_INTRO = [
    "Every row of a log is one of these messages, as bytes of ROS 2 (CDR). This page and the ROS 2",
    "package `testbed/core/records/testbed_msgs` are made from `testbed/core/records/messages.py`",
    "by `python -m testbed.core.records`.",
    "",
    "SI units and radians. Poses and twists are in the table frame, wrenches in the body frame.",
    "An unknown number is NaN. Vehicles, obstacles and rows of the fault table are numbered in the",
    "order of the message `Names`. The length of a sequence is a capacity; its `..._valid` says",
    "how many of its elements count. A text is never in a row: the row has a code, and the newest",
    "`Event` of that kind before the row has the text.",
]
