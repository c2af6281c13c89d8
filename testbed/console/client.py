"""A client of the operator's page for programs: the newest picture, and requests to the flight."""

import json
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlsplit


class PageClient:
    """One connection to a page.

    Args:
        url: of the page, on loopback.
    """

    def __init__(self, url: str) -> None:
        self._link = HTTPConnection(urlsplit(url).netloc, timeout=10.0)
        self._stamp = 0  # newest time that the server has said

    def picture(self) -> dict[str, Any]:
        """The newest picture."""
        self._link.request("GET", "/picture?after=")
        return self._answer()

    def request(self, kind: str, **fields: Any) -> dict[str, Any]:
        """Send a request of `net/operator_requests.py`: whether it was carried out, and words."""
        body = json.dumps({"type": kind, **fields})
        self._link.request("POST", "/request", body, {"X-Console": "request"})
        reply = self._answer()
        self._stamp = int(reply["now"])
        return reply

    def steer(self, vehicle: str, x: float, y: float, turn: float = 0.0, mode: str = "velocity",
              by: str = "script") -> dict[str, Any]:  # fmt: skip
        """Fly a vehicle by hand, for 0.3 s at most; `mode` "law" gives it back."""
        return self.request("Steer", vehicle=vehicle, x=x, y=y, turn=turn, mode=mode, by=by,
                            stamp_ns=self._stamp)  # fmt: skip

    def _answer(self) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(self._link.getresponse().read())
        return answer

    def close(self) -> None:
        """Close the connection."""
        self._link.close()
