"""Writes the ROS 2 package and the page of reference: `python -m testbed.core.records`."""

from pathlib import Path

from testbed.core.records.ros import package, page

HERE = Path(__file__).parent


def main() -> None:
    """Write the ROS 2 package and the page of reference."""
    for name, text in package().items():
        path = HERE / "testbed_msgs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (HERE.parents[2] / "docs" / "messages.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
