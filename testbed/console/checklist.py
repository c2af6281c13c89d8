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
    "pose rate": "compare mocap.rate_hz with the cameras; look for losses",
    "estimate": "look for reflections, for two bodies alike, for vibration",
    "fence": "carry it in from the edge",
    "start": "carry it to its start; if it is there, the cameras' axes are wrong",
    "at rest": "let it stand; look for noise of the cameras",
    "clear of": "move one of the two away",
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
    "law": "the message says where the law fails",
}


class Item(Struct, frozen=True):
    """One line of the checklist."""

    name: str  # "sat1 pose"
    reason: str  # why it is red; empty: green
    to_do: str = ""


def what_to_do(check: str) -> str:
    """What to do about a red check, by its name: vehicle and kind."""
    kind = check.partition(" ")[2]
    return TO_DO.get("clear of" if kind.startswith("clear of") else kind, "")


def write_checks(folder: Path, checks: Sequence[Check]) -> None:
    """Write the newest checks of all vehicles into the run folder."""
    rows = [Item(one.name, one.reason, what_to_do(one.name)) for one in checks]
    with suppress(OSError):  # such as a full disk, which is a check of its own
        write_atomic(folder / FILE, msgspec.json.encode(rows))


def read_checks(folder: Path) -> list[Item]:
    """The newest checks; none on a rig that writes none."""
    try:
        return msgspec.json.decode((folder / FILE).read_bytes(), type=list[Item])
    except (OSError, msgspec.MsgspecError):
        return []


def of_reasons(reasons: Sequence[str]) -> list[Item]:
    """Red lines from a run's reasons, "sat1 pose: why"."""
    found = []
    for one in reasons:
        name, _, why = one.partition(": ")
        found.append(Item(name, why or name, what_to_do(name)))
    return found
