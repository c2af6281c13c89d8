"""`testbed ros2`, and the publisher beside a flight of a lab with `network.ros2`."""

import subprocess
import sys
from pathlib import Path
from threading import Event
from time import monotonic

from testbed.cli.exit_code import OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text
from testbed.core.error import TestbedError
from testbed.core.lab import Network
from testbed.logs.log_reader import LogReader, log_of
from testbed.net.ros2 import Ros2Node
from testbed.net.ros2_publisher import ROUTER, WAIT_S, publish
from testbed.net.session import NoHostError, dial
from testbed.run.recorded import check_files

LAST_S = 2.0  # time for the last messages after a flight


def publish_run(run: Path, endpoint: str, domain: int, speed: float) -> int:
    """Publish a run from its beginning until its end or Ctrl-C."""
    try:
        log = LogReader(log_of(run))
        check_files(log.path)
        with dial(endpoint, WAIT_S) as session:
            node = Ros2Node(session, domain)
            number = publish(log, node, monotonic, Event().wait, speed)
    except NoHostError:
        expected, found = "the router of ROS 2", "no answer"
        return refuse(TestbedError(where=endpoint, expected=expected, found=found, hint=ROUTER))
    except TestbedError as error:
        return refuse(error)
    except KeyboardInterrupt:
        return OK
    for line in log.missing():
        print_text(errors, f"warning: {line}", "yellow")
    errors.print(f"{number} messages published", markup=False)
    return OK


def publisher_beside(folder: Path, network: Network) -> "subprocess.Popen[bytes]":
    """Start publishing a run that is about to fly, without waiting for it."""
    words = [sys.executable, "-m", "testbed.net.ros2_publisher", str(folder)]
    return subprocess.Popen(
        [*words, network.ros2_endpoint, str(network.ros2_domain)],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sys.stderr,
        start_new_session=True,
    )  # fmt: skip


def end(publisher: "subprocess.Popen[bytes]") -> None:
    """After the flight: let it publish the last messages, then end it."""
    try:
        publisher.wait(LAST_S)
    except subprocess.TimeoutExpired:
        publisher.terminate()
        publisher.wait()
