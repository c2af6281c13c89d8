"""The arming checklist: the host writes it into the run folder, the page shows what to do."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec import Struct

from testbed.files import write_atomic
from testbed.flight.arming import Check

FILE = "arming.json"
TO_DO = {
    "agent": "start `testbed agent` on its computer; check its Wi-Fi",
    "pose": "uncover the markers; `testbed poses` shows what the cameras see",
    "pose_rate": "compare mocap.rate_hz with the cameras; look for losses",
    "estimate": "look for reflections, for two bodies alike, for vibration",
    "fence": "carry it in from the edge",
    "start": "carry it to its start; if it is there, the cameras' axes are wrong",
    "heading": "turn it to its start; if it is right, the body in the camera system is turned",
    "at_rest": "let it stand; look for noise of the cameras",
    "spin": "let it stand; look for noise of the cameras",
    "clear_of": "move one of the two away",
    "board": "check port, power and image of the valve board",
    "supply": "open the air; check the regulator",
    "battery": "charge or change the battery",
    "valves": "do not float; check the wiring, then the board",
    "link": "check the Wi-Fi, and that the agent runs",
    "clock": "wait; a busy machine or network answers too late",
    "session": "stop the other host of this lab",
    "config": "start its agent again",
    "disk": "free space where the log goes",
    "operator": "answer the question at the terminal",
    "commissioned": "run `testbed commission`",
    "frame": "compare the cameras' frame and the table file",
    "checks": "try again",
    "law": "the message says where the law fails",
}


class Item(Struct, frozen=True):
    """One line of the checklist."""

    name: str  # "sat1 pose"
    reason: str  # why it is red; empty: green
    to_do: str = ""


def items_of(checks: Sequence[Check]) -> list[Item]:
    """The lines of the checklist."""
    return [Item(one.name, one.reason, TO_DO.get(one.id, "")) for one in checks]


def write_checks(folder: Path, checks: Sequence[Check]) -> None:
    """Write the newest checks of all vehicles into the run folder."""
    with suppress(OSError):  # such as a full disk, which is a check of its own
        write_atomic(folder / FILE, msgspec.json.encode(items_of(checks)))


def read_checks(folder: Path) -> list[Item]:
    """The newest checks; none on a rig that writes none."""
    try:
        return msgspec.json.decode((folder / FILE).read_bytes(), type=list[Item])
    except (OSError, msgspec.MsgspecError):
        return []
