"""Forwards the page's requests to the flight, and shows what can be changed now.

A request is JSON of `net/operator_requests.py`. The flight does not reply to a stick message.
Instead this process gives the page the time, which the page sends with its next message, so that
the flight knows how old that message is at most.
"""

from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import msgspec

from testbed.config import Experiment
from testbed.config.tunable import Tunable, tunables
from testbed.console.hub import Hub
from testbed.net.flight_note import request_socket
from testbed.net.operator_requests import OperatorRequest, ReadControls, Steer, ask, send
from testbed.realtime.wall_clock import monotonic_ns

WAIT_S = 4.0  # for the flight's reply; vehicles may be asked over the network
PATIENCE_S = 1.5  # the same for what can be changed now
LOOK_S = 0.3  # between two looks at that
DECADES = 10.0  # reach of a slider without a bound, times the start value

_open = msgspec.json.Decoder(OperatorRequest).decode


class RequestForwarder:
    """Forwards requests of a page to its flight.

    Args:
        note: the note of the run's flight, None without one.
    """

    def __init__(self, note: Callable[[], Path | None]) -> None:
        self._note = note

    def request(self, data: bytes) -> dict[str, Any]:
        """Forward a request: whether it was carried out, in words, and the time of this machine."""
        path, now = self._socket(), str(monotonic_ns())  # as text: larger than a browser's numbers
        try:
            request = _open(data)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return {"ok": False, "words": f"not understood: {error}", "now": now}
        if path is None:
            return {"ok": False, "words": "this flight cannot be changed", "now": now}
        if isinstance(request, Steer):
            sent = send(path, request)
            return {"ok": sent, "words": "" if sent else "the flight does not answer", "now": now}
        reply = ask(path, request, WAIT_S)
        if reply is None:
            return {"ok": False, "words": "the flight does not answer", "now": now}
        return {"ok": reply.ok, "words": reply.words, "now": now}

    def keep(self, left: Event, hub: Hub) -> None:
        """Show what can be changed, until `left` is set."""
        while not left.is_set():
            hub.set_status(controls=self.now())
            left.wait(LOOK_S)

    def now(self) -> dict[str, Any] | None:
        """What can be changed now; None: nothing."""
        path = self._socket()
        reply = None if path is None else ask(path, ReadControls(), PATIENCE_S)
        return None if reply is None else msgspec.to_builtins(reply.controls)

    def _socket(self) -> Path | None:
        note = self._note()
        path = None if note is None else request_socket(note)
        return path if path is not None and path.exists() else None


def sliders(experiment: Experiment) -> list[dict[str, Any]]:
    """A slider for each parameter of the law: name, start, bounds in words, and its reach."""
    return [
        {"name": one.name, "start": one.value, "bounds": bounds(one), "reach": reach(one)}
        for one in tunables(experiment.controller)
    ]


def bounds(one: Tunable) -> str:
    """The bounds of a parameter in words; empty: none."""
    low = "" if one.low is None else f"{'more than' if one.open_low else 'at least'} {one.low:g}"
    high = "" if one.high is None else f"{'less than' if one.open_high else 'at most'} {one.high:g}"
    return ", ".join(filter(None, (low, high)))


def reach(one: Tunable) -> tuple[float, float, bool]:
    """Ends of a parameter's slider, within its bounds, and whether it is logarithmic."""
    bounded = one.low is not None and one.high is not None
    if one.value > 0.0 and not bounded and (one.low is None or one.low >= 0.0):
        low = max(one.value / DECADES, one.low or 0.0)
        return low, min(one.value * DECADES, one.high or float("inf")), True
    size = abs(one.value) or 1.0
    low = one.value - size if one.low is None else one.low
    high = one.value + size if one.high is None else one.high
    inside = 1e-3 * (high - low)  # an open bound is not a value
    return low + inside * one.open_low, high - inside * one.open_high, False
